"""How a verb says that it was given something it cannot use."""

# Exit codes of every verb.
DONE = 0
BAD_INPUT = 2
NO_MODEL = 3


class CliError(Exception):
    """Input that a verb cannot use: printed as one line on stderr, exit code 2."""
