"""Recorded frames of which something hides a part."""

import numpy as np

from debris_scanner.frames import TargetFrame


def shaded(target, share):
    """The frame with a part of the target, from the top, behind a straight shadow's edge."""
    depth, fitted, normals = target.depth.copy(), target.depth_fit.copy(), target.normals.copy()
    rows = np.nonzero(depth.any(axis=1))[0]
    dark = rows[0] + round(share * len(rows))
    depth[:dark], fitted[:dark], normals[:dark] = 0, 0, 0
    return TargetFrame(target.stamp_ns, target.camera, depth, fitted, normals)
