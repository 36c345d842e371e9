"""Words of a command line."""


def last(*words: str) -> list[str]:
    """The words, of those that give one key the last alone: commands take a key once."""
    return list({word.partition("=")[0]: word for word in words}.values())
