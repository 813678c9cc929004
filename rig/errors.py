"""The error that a user of the rig can meet: one message that says what to do next."""


class RigError(Exception):
    """What was asked cannot be done. The command line prints the message and exits with 2."""

    @classmethod
    def value(cls, where: str, given: object, allowed: str, advice: str = "") -> "RigError":
        """The message for one bad value: `where` is a field's path, an option, or a device."""
        message = f"{where}: given {given}; allowed {allowed}"
        return cls(f"{message}; {advice}" if advice else message)
