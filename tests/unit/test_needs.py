"""What tests need from the system is what ``make test`` installs, and its absence is a failure in CI."""

from __future__ import annotations

import subprocess

import pytest

from tests import ROOT, needs


def test_each_package_that_make_installs_has_a_check_and_each_check_a_package() -> None:
    done = subprocess.run(
        ["make", "-s", "-C", ROOT, "--eval", "say: ; @echo $(APT)", "say"], capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == set(needs.PACKAGES)


@pytest.mark.parametrize("package", needs.PACKAGES)
def test_a_package_that_is_missing_is_a_failure_in_ci_and_a_reason_to_skip_elsewhere(
    package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(needs.PACKAGES, package, lambda: False)
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match=package):
        needs.need("tmux", package)
    monkeypatch.delenv("CI")
    with pytest.raises(pytest.skip.Exception, match=package):
        needs.need("tmux", package)
