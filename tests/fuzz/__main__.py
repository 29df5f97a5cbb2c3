"""Runs cases and prints those that did not end with one sentence and a documented status."""

from __future__ import annotations

import argparse
import collections
import contextlib
import os
import shutil
import sys
import tempfile
import time
import traceback
from pathlib import Path

from tests.fuzz.read_only_world import enter_read_only_world
from tests.system.appliance import Appliance


def main() -> int:
    """Run from the command line; returns 1 if any case ended badly."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="number of one case, shown in full")
    asked = parser.parse_args()
    kernels = Path(tempfile.gettempdir()) / "sweepscope-fuzz-kernels"
    kernels.mkdir(exist_ok=True)
    os.environ["NUMBA_CACHE_DIR"] = str(kernels)
    with tempfile.TemporaryDirectory(prefix="fz-") as folder:
        pid = os.fork()  # whoever removes the folder must be outside of the read-only world
        if pid == 0:
            os._exit(_in_a_world_of_its_own(asked, Path(folder), kernels))
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def _in_a_world_of_its_own(asked: argparse.Namespace, folder: Path, kernels: Path) -> int:
    try:
        if os.getuid() == 0:
            enter_read_only_world(folder, kernels)
        return _run_all(asked, folder, kernels)
    except BaseException:  # noqa: BLE001 - the outermost end of this process
        traceback.print_exc()
        return 1
    finally:
        sys.stdout.flush()


def _run_all(asked: argparse.Namespace, folder: Path, kernels: Path) -> int:
    from tests.fuzz import corpus, runner  # noqa: PLC0415 - they start threads
    from tests.fuzz.cases import make_cases  # noqa: PLC0415

    runner.prepare()
    runner.adopt_orphans()
    kinds: collections.Counter[str] = collections.Counter()
    slowest, all_began_s = 0.0, time.monotonic()
    (folder / "corpus").mkdir()
    known = corpus.build(folder / "corpus")
    cases = make_cases(asked.count, asked.seed, known)
    chosen = cases if asked.only is None else [cases[asked.only]]
    with contextlib.closing(_rig(folder)) as rig:
        for case in chosen:
            work = _copy(known.folder, folder / "w")
            began_s = time.time()
            end = runner.run(case, work, rig.run_dir)
            compiled = any(path.stat().st_mtime >= began_s for path in kernels.rglob("*.nbi"))
            runner.end_leftovers({process.pid for process in rig.processes.values()})
            shutil.rmtree(work)
            wrong = runner.judge(case, end, may_be_slow=compiled) or _dead(rig)
            kinds[wrong or "good"] += 1
            slowest = max(slowest, end.cpu_s)
            if wrong or asked.only is not None:
                print(runner.told(case, end, wrong), flush=True)
    print(
        f"{len(chosen)} cases in {time.monotonic() - all_began_s:.0f} s, slowest {slowest:.1f} s of processor time: "
        + ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    )
    return int(set(kinds) != {"good"})


def _rig(folder: Path) -> Appliance:
    for name in ("live", "scans"):
        (folder / name).mkdir(mode=0o700)
    rig = Appliance(folder / "live", folder / "scans")
    rig.start("daemon", "writer")
    rig.client().close()
    return rig


def _dead(rig: Appliance) -> str:
    """The services that the case has ended, which are started again."""
    dead = {name: process.poll() for name, process in rig.processes.items() if process.poll() is not None}
    if not dead:
        return ""
    log = rig.log.read_text(encoding="utf-8", errors="replace")[-2000:]
    rig.start(*dead)
    rig.client().close()
    return f"a service died (status {dead}): {log}"


def _copy(known: Path, work: Path) -> Path:
    shutil.copytree(known, work, symlinks=True, ignore=shutil.ignore_patterns("pipe"))
    os.mkfifo(work / "pipe")
    (work / "home").mkdir()
    (work / "run").mkdir(mode=0o700)
    return work


if __name__ == "__main__":
    sys.exit(main())
