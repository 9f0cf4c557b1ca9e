"""The errors that readers of messages and bags raise, each with one line of text."""


class _OneLine(ValueError):
    """Names from a damaged message may hold line breaks and control characters; its report must not."""

    def __init__(self, text: str) -> None:
        super().__init__(''.join(c if c.isprintable() else ' ' for c in text))


class MalformedMessage(_OneLine):
    """A message that contradicts itself, or lacks what it is read for; the text names the thing."""


class BagError(_OneLine):
    """A bag that cannot be read or written at all; the text names the thing."""
