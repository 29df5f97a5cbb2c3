"""The rig side: stage, camera, sweep, writer; promises that no committed frame is ever lost."""
