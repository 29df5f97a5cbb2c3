"""From frames to points: fold, crossings, geometry, cloud, worker, viewer."""
