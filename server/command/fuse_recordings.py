"""What `asterism fuse RECORDING ... -o OUT` does."""

import argparse

from asterism.protocol.errors import InputError


def fuse_recordings(options: argparse.Namespace) -> int:
    """Join the recordings' frames into lines. Raises InputError for recordings that do not fit together."""
    raise InputError(f"{options.recordings[0]}: fusing recordings is not there yet; expected none")
