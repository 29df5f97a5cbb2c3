"""The long noise run: python -m tests.firmware.noise_run --seeds 20 --bytes 10000000

Relative moves of one microstep under noise, both ways, counted against the pins: a command that ran twice, was lost
after its answer, or was damaged unnoticed moves the stage by a wrong amount and ends the run with status 1.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
import time
from concurrent.futures import Future
from pathlib import Path

from acquire.stages.uno.emulator import build_firmware
from acquire.stages.uno.framing import Block
from acquire.stages.uno.wire_format import AckBody, Cmd, GrantBody, McuState, MoveBody, Result, StatusBody

from .conftest import Bench

BATCH = 8
ANSWER_S = 30.0


def _ran(answer: Future[Block]) -> bool:
    return AckBody.unpack(answer.result(timeout=ANSWER_S).body).result == Result.OK


def run_seed(bench: Bench, seed: int, traffic_bytes: int, share: float) -> tuple[int, int, int]:
    """One seed; (moves acknowledged, steps at the pins, bytes that were hurt)."""
    bench.move(50)
    bench.emulator.knob(f"seed {seed}")
    bench.emulator.knob(f"noise {share}")
    before, place, moved = bench.pins(), 50, 0
    while (pins := bench.pins()).bytes_in + pins.bytes_out - before.bytes_in - before.bytes_out < traffic_bytes:
        distance = 1 if place < 100 else -1
        moves = [bench.stage.send(Cmd.MOVE, MoveBody(distance, 1, 0).pack()) for _ in range(BATCH)]
        bench.stage.send(Cmd.GRANT, GrantBody(-1).pack())
        bench.stage.keep_alive()
        done = sum(map(_ran, moves))
        moved, place = moved + done, place + distance * done
    bench.emulator.knob("noise 0")
    while (
        bench.stage.send(Cmd.STATUS, StatusBody(0).pack()).result(timeout=3)
        and bench.stage.report.state != McuState.IDLE
    ):
        bench.stage.keep_alive()
    after = bench.pins()
    if bench.stage.report.position != place:
        raise SystemExit(f"seed {seed}: the firmware counts {bench.stage.report.position}, the host {place}")
    return moved, after.steps - before.steps, after.hurt - before.hurt


def main() -> None:
    """Run all seeds; says what came out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--bytes", type=int, default=10_000_000)
    parser.add_argument("--share", type=float, default=1e-3)
    options = parser.parse_args()
    started_s, moves, hurt, wrong = time.monotonic(), 0, 0, 0
    with tempfile.TemporaryDirectory() as name:
        built = build_firmware(Path(name))
        for seed in range(1, options.seeds + 1):
            with contextlib.closing(Bench(built)) as bench:
                moved, steps, damaged = run_seed(bench, seed, options.bytes // options.seeds, options.share)
                counters = bench.stage.counters()
            moves, hurt, wrong = moves + moved, hurt + damaged, wrong + abs(steps - moved)
            print(f"seed {seed}: {moved} moves, {steps} steps, {damaged} bytes hurt, {counters}", flush=True)
    print(f"{moves} moves, {wrong} wrong steps, {hurt} bytes hurt, {time.monotonic() - started_s:.0f} s")
    raise SystemExit(wrong > 0)


if __name__ == "__main__":
    main()
