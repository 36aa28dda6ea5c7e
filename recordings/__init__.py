"""Recordings: folders of MCAP files that hold what was published, byte for byte, and the frames it came from.

    poses-0001.mcap, ...   zstd; the published messages on channels named like their keys, plus `/tf`, the camera's
                           calibration and image annotations for viewers; flushed every second
    frames-0001.mcap, ...  the images as they are, or windows around spots (zstd)

`log_time` is the mid-exposure in both, so they line up by themselves. Any MCAP tool, Foxglove and the rerun viewer
read them as they are.
"""
