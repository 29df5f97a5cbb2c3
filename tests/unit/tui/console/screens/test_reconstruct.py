"""The reconstruct screen: the threshold shows at once, the cursor tells values, g makes the files."""

from __future__ import annotations

import re

import msgspec
from textual.widgets import Input

from acquire.contract.states import Outcome, State
from tests.fakes.fake_daemon import IDLE, PROGRESS, SWEEPING
from tests.fakes.scans.small_scans import make_scan
from tests.fakes.scans.some_maps import live_maps, write_maps
from tests.unit.tui.console.played_console import play
from tui.console.link.messages import MapsArrived, ProgressArrived, StatusArrived
from tui.console.screens.reconstruct import ReconstructScreen
from tui.console.widgets.contrast_pane import ContrastPane
from tui.console.widgets.map_view import MapView

MAPS = (ProgressArrived(msgspec.structs.replace(PROGRESS, scan_uid="uid-1")), MapsArrived(live_maps()))
ENDED = msgspec.structs.replace(SWEEPING, state=State.IDLE, outcome=Outcome.COMPLETE, committed=527)


def pixels_over(console) -> int:
    found = re.search(r"([\d ]+) pixels over it", console.shown(ContrastPane))
    assert found, console.shown(ContrastPane)
    return int(found[1].replace(" ", ""))


def test_the_four_maps_stand_side_by_side_with_their_ranges():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        screen = console.painted
        for words in ("minimum", "maximum", "contrast mask", "crossing time", "255 counts", "526 frames"):
            assert words in screen
        assert "through frame 409 of 527" in screen

    play(script, screen="reconstruct")


def test_a_higher_threshold_leaves_fewer_pixels_at_once():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        before, painted = pixels_over(console), console.screen.query_one("#mask", MapView).painted
        await console.press("right_curly_bracket", "right_curly_bracket", "right_square_bracket")
        assert "contrast  91" in console.shown(ContrastPane)
        assert 0 < pixels_over(console) < before
        assert console.screen.query_one("#mask", MapView).painted > painted

    play(script, screen="reconstruct")


def test_below_the_folds_threshold_it_says_that_crossings_are_not_known():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        await console.press("left_square_bracket")
        assert "crossings under 70 are not known until g makes it" in console.shown(ContrastPane)

    play(script, screen="reconstruct", size=(120, 30))


def test_a_typed_threshold_is_taken_and_nonsense_is_refused():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        await console.press("t", "9", "9", "9", "enter")
        assert "whole number from 0 to 255" in console.painted
        console.app.screen.query_one(Input).value = "30"
        await console.press("enter")
        assert "contrast  30" in console.shown(ContrastPane)

    play(script, screen="reconstruct")


def test_the_cursor_moves_and_tells_the_values_of_its_pixel():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        assert "x 128  y 96" in console.shown(ContrastPane)
        await console.press("right", "up")
        found = re.search(r"x (\d+)  y (\d+)  min \d+  max \d+  contrast \d+ \(over\)", console.shown(ContrastPane))
        assert found and int(found[1]) > 128 and int(found[2]) < 96
        await console.press("plus", "plus")
        assert "zoom 4" in console.shown(ContrastPane)

    play(script, screen="reconstruct")


def test_one_map_can_fill_the_place_and_all_four_come_back():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        await console.press("w")
        assert [view.id for view in console.screen.query(MapView) if view.display] == ["minimum"]
        await console.press("w", "w", "w", "w")
        assert all(view.display for view in console.screen.query(MapView))

    play(script, screen="reconstruct")


def test_equal_maps_are_not_painted_again():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        painted = [view.painted for view in console.screen.query(MapView)]
        await console.hear(StatusArrived(msgspec.structs.replace(SWEEPING, committed=411)), MapsArrived(live_maps()))
        assert [view.painted for view in console.screen.query(MapView)] == painted

    play(script, screen="reconstruct")


def test_maps_of_the_scan_before_are_not_shown_as_those_of_a_new_one():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        await console.hear(StatusArrived(msgspec.structs.replace(SWEEPING, scan_uid="uid-2")))
        assert "waiting for the worker's first maps" in console.painted
        await console.hear(MapsArrived(live_maps(scan_uid="uid-2")))
        assert pixels_over(console) > 0

    play(script, screen="reconstruct")


def test_a_running_sweep_is_not_made_and_the_reason_is_said():
    async def script(console):
        console.watch_jobs()
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        await console.press("g")
        assert console.started == [] and "its files are made at its end" in console.log

    play(script, screen="reconstruct")


def test_g_makes_the_scan_with_the_settings_that_are_shown_and_reads_its_maps(tmp_path):
    folder = write_maps(make_scan(tmp_path / "a"))
    ended = msgspec.structs.replace(ENDED, scan_path=str(folder))

    async def script(console):
        console.watch_jobs()
        await console.connect(ended)
        await console.hear(*MAPS)
        await console.press("right_square_bracket", "k", "g")
        (arguments, subject) = console.started[0]
        assert subject == str(folder)
        wanted = ["reconstruct", str(folder), "--json", "--progress", "--contrast", "71", "--method", "auto"]
        assert arguments == wanted
        await console.end_job({"points": 12345, "warnings": []})
        await console.until(lambda: "(maps.h5)" in console.painted, "the maps of the file")
        assert "12345 points" in console.log

    play(script, screen="reconstruct")


def test_an_older_scan_is_read_from_its_file_and_the_way_back_leads_to_the_sweep(tmp_path):
    folder = write_maps(make_scan(tmp_path / "a"), contrast=60)

    async def script(console):
        await console.connect(SWEEPING)
        screen = console.screen
        assert isinstance(screen, ReconstructScreen)
        screen.open_scan(folder)
        await console.until(lambda: "contrast  60" in console.shown(ContrastPane), "the maps of the file")
        assert "a (maps.h5)" in console.painted and pixels_over(console) > 0
        await console.hear(*MAPS)
        assert "a (maps.h5)" in console.painted, "the sweep does not push itself into view"
        await console.press("L")
        assert "live: " in console.painted and "contrast  70" in console.shown(ContrastPane)

    play(script, screen="reconstruct", data_dir=tmp_path)


def test_an_older_scan_without_readable_maps_says_so(tmp_path):
    folder = make_scan(tmp_path / "a")
    (folder / "maps.h5").write_bytes(b"nothing")

    async def script(console):
        await console.connect(IDLE)
        console.screen.open_scan(folder)
        await console.until(lambda: "not a readable" in console.painted, "the reason")
        await console.press("plus")
        assert "there are no maps" in console.log

    play(script, screen="reconstruct", size=(160, 50))


def test_before_anything_is_known_it_says_so_and_nothing_breaks():
    async def script(console):
        assert "not connected - retrying" in console.painted
        await console.press("plus", "right", "g", "w", "left_square_bracket")
        await console.connect(IDLE)
        assert "no sweep yet; 4 opens an older scan" in console.painted

    play(script, screen="reconstruct", size=(160, 50))


def test_plain_ascii_draws_the_maps_with_letters_only():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(*MAPS)
        assert "/" in console.painted and "@" in console.painted
        assert all(view.render_line(y).text.isascii() for view in console.screen.query(MapView) for y in range(8))
        assert console.shown(ContrastPane).isascii()

    play(script, screen="reconstruct", ascii_only=True)
