"""One module a command, each with `run(options) -> exit code`; imported only when the command is asked for."""
