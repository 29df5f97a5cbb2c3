"""Commands to the daemon itself: control, status, acknowledge, shutdown."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from acquire.contract.messaging.messages import Status
from acquire.daemon.requests import AcknowledgeRequest, Call, ControlRequest, NoArguments, Result
from acquire.rigs.status_board import StatusBoard

from .control import Control


class ServiceCommands:
    """Handlers of the table of commands."""

    def __init__(
        self,
        control: Control,
        board: StatusBoard,
        current_status: Callable[[int], Status],
        request_end: Callable[[], None],
    ) -> None:
        """``request_end`` ends the daemon after this turn of its loop."""
        self._control, self._board = control, board
        self._current_status, self._request_end = current_status, request_end

    def control(self, request: ControlRequest, call: Call) -> Result:
        """Take control, keep it, or release it."""
        self._control.change(request.action, call.client, call.now_ns)
        return {"holder": self._control.holder(call.now_ns)}

    def status(self, _request: NoArguments, call: Call) -> Result:
        """The status message."""
        fields: Result = msgspec.to_builtins(self._current_status(call.now_ns))
        return fields

    def acknowledge(self, request: AcknowledgeRequest, _call: Call) -> Result:
        """The operator has seen faults."""
        return {"acknowledged": self._board.acknowledge(request.code)}

    def shutdown(self, _request: NoArguments, _call: Call) -> Result:
        """End the daemon; a running scan is brought to its end first."""
        self._request_end()
        return {}
