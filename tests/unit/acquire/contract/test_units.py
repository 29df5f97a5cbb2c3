import pytest

from acquire.contract.units import nice_length


@pytest.mark.parametrize(
    ("length", "below", "above"),
    [(0.9, 0.5, 1.0), (1.0, 1.0, 1.0), (1.3, 1.0, 2.0), (0.021, 0.02, 0.05), (7.0, 5.0, 10.0), (0.0, 1e-12, 1e-12)],
)
def test_a_nice_length_is_1_2_or_5_times_a_power_of_ten(length: float, below: float, above: float) -> None:
    assert nice_length(length) == pytest.approx(below)
    assert nice_length(length, above=True) == pytest.approx(above)
