"""The error tree. Whoever raises one names what was wrong, where, and what was expected."""

from __future__ import annotations


class HitchhikeError(Exception):
    """Base of every error that this package raises on purpose."""


class InputFileError(HitchhikeError):
    """A file cannot be used: it names the file, the field, its value and what was expected."""

    def __init__(self, file: object, field: str, value: object, expected: str) -> None:
        self.file, self.field, self.value, self.expected = str(file), field, value, expected
        where = f"{file}: {field}" if field else str(file)
        super().__init__(f"{_short(where)} is {_short(repr(value))}, expected {_short(expected, 2000)}")


def _short(text: str, most: int = 300) -> str:
    """``text`` on one line, and only its beginning where a file has put too much into it."""
    line = " ".join(text.split())
    return line if len(line) <= most else f"{line[:most]} …"


class MapFileError(InputFileError):
    """A map_server YAML or its image cannot be used."""


class WorldFileError(InputFileError):
    """A world file cannot be used."""


class ParameterError(InputFileError):
    """A parameter, from a file or from the parameter server, cannot be used."""


class RobotModelError(InputFileError):
    """A URDF lacks a link that a module needs."""


class LedgerError(InputFileError):
    """The award ledger cannot be read or written: permissions, a full disk, another process that keeps it busy."""


class LedgerFormatError(LedgerError):
    """The file is damaged, or no award ledger."""


class CreditError(LedgerError):
    """What is to be credited is senseless; trying again does not help."""


class PlanningError(HitchhikeError):
    """No path: the subclass says why."""


class StartBlockedError(PlanningError):
    """The start is inside an obstacle or its inflation."""


class GoalBlockedError(PlanningError):
    """The goal is inside an obstacle or its inflation."""


class OutsideMapError(PlanningError):
    """Start or goal is not on the map."""


class UnreachableError(PlanningError):
    """Both ends are free, but no path joins them."""


class ItineraryInputError(PlanningError):
    """What a robot announced or asked for cannot be planned with: it names the robot, the field and its value."""

    def __init__(self, robot: str, field: str, value: object, expected: str) -> None:
        self.robot, self.field, self.value, self.expected = robot, field, value, expected
        super().__init__(f"{robot}: {field} is {value!r}, expected {expected}")


class MessageError(HitchhikeError):
    """A network message cannot be read or is not acceptable."""


class TransitionError(HitchhikeError):
    """A state machine got a command that its state does not allow; ``state`` and ``event`` are their names."""

    def __init__(self, state: str, event: str) -> None:
        self.state, self.event = state, event
        super().__init__(f"{event} is not allowed in {state}")


class VisionError(HitchhikeError):
    """An image, its calibration or a marker setting cannot be used."""


class SensorDataError(HitchhikeError):
    """A sensor reading is senseless (NaN, wrong length, time running backwards)."""


class StaleInputError(SensorDataError):
    """An input or an order that a module needs is missing or too old."""


class FrameError(HitchhikeError):
    """A pose is given in a frame that nothing connects with the map."""


class TeleopError(HitchhikeError):
    """A robot that a human drives cannot go on as the human wants, or there is nothing to drive it with."""
