"""One module a command: EXAMPLES, `add_arguments(part)` (or SUBCOMMANDS), and `run(options)` -> exit code."""
