import numpy as np
import pytest

from acquire.contract.colormaps import NO_VALUE_RGB, QUANTITY_MAP, coloured, table


@pytest.mark.parametrize("name", ["viridis", "cividis"])
def test_a_sequential_map_grows_lighter_all_the_way(name: str) -> None:
    luminance = table(name).astype(float) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) > -0.6).all()
    assert luminance[-1] - luminance[0] > 150


def test_the_signed_map_is_neutral_in_its_middle_and_blue_below_it() -> None:
    signed = table("blue-orange").astype(int)
    middle = signed[127]
    assert np.ptp(middle) < 20
    assert signed[20][2] > signed[20][0] + 50
    assert signed[235][0] > signed[235][2] + 50


def test_values_outside_the_range_take_its_ends_and_no_value_is_no_colour_of_the_map() -> None:
    shown = coloured([-5.0, 0.0, 10.0, 99.0, np.nan, np.inf], 0.0, 10.0, "viridis")
    assert shown[0].tolist() == shown[1].tolist() == table("viridis")[0].tolist()
    assert shown[2].tolist() == shown[3].tolist() == table("viridis")[255].tolist()
    assert shown[4].tolist() == shown[5].tolist() == list(NO_VALUE_RGB)
    for name in set(QUANTITY_MAP.values()):
        assert list(NO_VALUE_RGB) not in table(name).tolist()


def test_a_range_without_width_does_not_divide_by_zero() -> None:
    assert coloured([3.0], 3.0, 3.0, "cividis").shape == (1, 3)
