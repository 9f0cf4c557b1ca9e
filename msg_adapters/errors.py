"""The error that every reader of messages raises."""


class MalformedMessage(ValueError):  # noqa: N818 - it reads as what the message is
    """A message that contradicts itself, or lacks what it is read for; the text names the thing."""
