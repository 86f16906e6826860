"""The two ways an estimate can end without a pose."""


class InputError(ValueError):
    """Bad input from the caller: says what was given, what was expected and the likely fix."""


class NoAnswer(Exception):
    """Raised by a stage when the image holds no answer; the estimator reports it as `found=False`.

    The message is a sentence for a person.
    """
