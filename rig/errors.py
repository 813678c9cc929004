"""Defines the rig's error. The message of the error says what is wrong and what to do next."""


class RigError(Exception):
    """Error of a device, file or value. The command line prints the message and exits with 2."""

    @classmethod
    def value(cls, where: str, given: object, allowed: str, advice: str = "") -> "RigError":
        """Returns the error for one invalid value. `where` names a field, an option or a device."""
        message = f"{where}: given {given}; allowed {allowed}"
        return cls(f"{message}; {advice}" if advice else message)
