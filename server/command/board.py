"""asterism board: a calibration board to print."""

import argparse

from asterism.protocol.errors import InputError
from asterism.protocol.program import typed
from asterism.server.calibration.lens.printed_board import printed_board
from asterism.server.calibration.lens.targets import parse_board
from asterism.server.command.shared_arguments import add_out
from asterism.server.design.page import pdf
from asterism.server.output import check_file, new_file

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
    add_out(part, "board.pdf", "what is written")


def run(options: argparse.Namespace) -> int:
    """Write the PDF, say on what paper it goes and what to do with it."""
    if options.out.suffix != ".pdf":
        raise InputError(f"{options.out}: expected a file name ending in .pdf")
    check_file(options.out, options.force)
    page = printed_board(parse_board(options.board))
    with new_file(options.out, options.force) as output:
        output.path.write_bytes(pdf(page))
    print(f"written: {options.out}, {page.width:g} x {page.height:g} mm{output.note}")
    print("print it at 100 %, check its bar with a ruler, glue it to something flat; then:")
    print(typed("calibrate", "camera", "SOURCE", "--target", options.board, "-o", "camera.yaml"))
    return 0
