"""asterism board: a calibration board to print."""

import argparse
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.server.calibration.lens.targets import parse_board
from asterism.server.calibration.result_file import check_result_file, write_result_file

EXAMPLES = (
    "asterism board chessboard:9x6:0.025 -o board.pdf\n"
    "asterism board charuco:8x6:0.028 -o board.pdf\n"
    "asterism board acircles:4x11:0.02 -o board.pdf\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument(
        "board",
        metavar="KIND:COLSxROWS:PITCH",
        help="KIND chessboard (COLS and ROWS count inner corners), circles, acircles or charuco (squares); PITCH in m",
    )
    part.add_argument("-o", "--out", metavar="board.pdf", type=Path, required=True, help="what is written")
    part.add_argument("--force", action="store_true", help="replace board.pdf; the old one is kept beside it")


def run(options: argparse.Namespace) -> int:
    """Write the PDF, say on what paper it goes and what to do with it."""
    check_result_file(options.out, options.force)
    if options.out.suffix != ".pdf":
        raise InputError(f"{options.out}: expected a file name ending in .pdf")
    target = parse_board(options.board)
    from asterism.server.calibration.lens.printed_board import printed_board
    from asterism.server.design.page import pdf

    page = printed_board(target)
    kept = write_result_file(options.out, pdf(page).decode("ascii"), options.force)
    aside = f"; the old one is kept as {kept}" if kept else ""
    print(f"written: {options.out}, {page.width:g} x {page.height:g} mm{aside}")
    print("print it at 100 %, check its bar with a ruler, glue it to something flat; then:")
    print(f"asterism calibrate camera SOURCE --target {options.board} -o camera.yaml")
    return 0
