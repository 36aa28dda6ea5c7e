"""The command line: `asterism COMMAND ...`. Only what a command needs is imported, so `--help` is there at once."""

import sys
from collections.abc import Sequence

from asterism.protocol.errors import InputError, WorldError
from asterism.server.command.parser import module_of, parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 1 the world failed, 2 the user's input is wrong."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        options = parser(words).parse_args(words)
        code: int = module_of(options.command).run(options)
    except InputError as error:
        print(f"asterism: {error}", file=sys.stderr)
        return 2
    except WorldError as error:
        print(f"asterism: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("asterism"):
            raise
        print(
            f"asterism: {words[0]} needs {error.name}; install it with: pip install 'asterism-localization[all]'",
            file=sys.stderr,
        )
        return 2
    except BrokenPipeError:
        return 1
    except KeyboardInterrupt:
        return 130
    return code


if __name__ == "__main__":
    sys.exit(main())
