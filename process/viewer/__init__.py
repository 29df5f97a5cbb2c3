"""The page in the browser: the cloud as it grows, the state of the rig, and on a loopback page its buttons."""

from .service import run_viewer

__all__ = ["run_viewer"]
