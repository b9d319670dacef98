"""The one error a user sees: a line that says what is wrong and what to do next."""

LONGEST = 1500


def one_line(text: str, longest: int = LONGEST) -> str:
    """Text as one line that a terminal only prints: no control characters, the middle left out where it is long.

    Names out of recordings and files stand in messages; none of them may clear a screen or fill it.

    Args:
        text: A message, with whatever control characters and line breaks.
        longest: Characters above which the middle gives way to " ... ".
    """
    if len(text) > longest:
        text = f"{text[: longest // 2]} ... {text[-longest // 2 :]}"
    return "".join(character if character.isprintable() else " " for character in text).strip()


class UserError(Exception):
    """Input that cannot be used (unreadable file, bad option); the command exits with status 2."""

    def __str__(self) -> str:
        return one_line(super().__str__())


class UnfitDataError(UserError):
    """Readable data that cannot carry the question (no motion, no torque); the command exits with status 1."""
