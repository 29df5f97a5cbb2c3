"""Which scan the page shows: the rig's own or an older one from its file; what follows for the cloud. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from process.viewer.exports.results_list import OpenedScan
from process.viewer.rig_client.feed import Snapshot, TileChanges
from process.viewer.rig_client.tile import Tile


class ShownScan:
    """The choice, the rig's own points beside it, and those of its finished scan, whose file knows their quality."""

    def __init__(self) -> None:
        self.opened: OpenedScan | None = None
        """The older scan that is shown; None: the rig's own."""
        self._snapshot = Snapshot()
        self._live: dict[int, Tile] = {}
        self._switched = False
        self._finished_path = ""
        self._finished: Mapping[int, Tile] = {}

    def show(self, opened: OpenedScan | None) -> None:
        """Show an older scan, or the rig's own again."""
        self.opened, self._switched = opened, True

    def changes(self, changes: TileChanges) -> TileChanges:
        """What the cloud has to take: the rig's changes, or all of another scan when the choice has changed."""
        if changes.reset:
            self._live.clear()
        self._live.update(changes.tiles)
        if self._switched:
            self._switched = False
            return TileChanges(True, dict(self._live if self.opened is None else self.opened.tiles))
        return changes if self.opened is None else TileChanges()

    @property
    def folder(self) -> Path | None:
        """Of the shown scan; None before the first."""
        if self.opened is not None:
            return self.opened.entry.folder
        status = self._snapshot.status
        return Path(status.scan_path) if status is not None and status.scan_path else None

    @property
    def title(self) -> str:
        """What the shown scan is called."""
        return self.folder.name if self.folder is not None else "no scan"

    def take(self, snapshot: Snapshot) -> None:
        """Note the state of the rig."""
        self._snapshot = snapshot

    def newly_finished(self) -> str:
        """Path of a cloud that is on disk and has not been asked for yet; empty if there is none."""
        path = self._finished_cloud
        if not path or path == self._finished_path:
            return ""
        self._finished_path, self._finished = path, {}
        return path

    def take_finished(self, path: str, tiles: Mapping[int, Tile]) -> None:
        """The points that were read from ``path``; passed over if another scan has ended meanwhile."""
        if path == self._finished_path:
            self._finished = tiles

    def pickable(self, shown: Mapping[int, Tile]) -> Mapping[int, Tile]:
        """The points that a click may mean: those of a finished scan's file rather than the live ones ``shown``."""
        is_finished = self._finished_cloud == self._finished_path
        return self._finished if self.opened is None and self._finished and is_finished else shown

    @property
    def _finished_cloud(self) -> str:
        return self._snapshot.end.cloud_path if self._snapshot.end is not None else ""
