"""`meaning_of`: what the name of a column says: quantity, unit, whose joint, measured or commanded.

Names are taken apart at punctuation, digits and capitals (`actualQ_3`, `Gelenk 3 Strom [mA]`, `tau_J[2]`), accents are
taken off, and what is left is looked up in short lists of the words that controllers and people use. A long word may
stand inside a longer one (`motorstrom`, `gelenkwinkel`); a short one must be all of a part (`q`, `tau`, `ist`).
"""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from functools import cache

TIME, INDEX, POSITION, VELOCITY, TORQUE, CURRENT, OTHER = (
    "time",
    "index",
    "position",
    "velocity",
    "torque",
    "current",
    "other",
)
_INSIDE = 4
"""Letters from which on a word counts inside a longer one; of scripts without capitals two are as many."""


def _words(text: str) -> tuple[str, ...]:
    return tuple(_plain(word) for word in text.split())


def _plain(text: str) -> str:
    """Lower case without accents; ligatures and full-width letters as ordinary ones."""
    folded = unicodedata.normalize("NFKD", text.casefold())
    return "".join(character for character in folded if not unicodedata.combining(character))


WORDS: dict[str, tuple[str, ...]] = {
    TIME: _words(
        "t ts time timestamp stamp clock zeit zeitstempel uhrzeit temps horodatage tiempo tempo czas tijd tid zaman "
        "aika cas время 时间 時間 時刻 시간 secs seconds sekunden segundos ipoc"
    ),
    INDEX: _words("index idx sample frame counter row zeile abtastung messwert muestra echantillon lfd 序号 номер"),
    POSITION: _words(
        "q qs pos position positions posn angle angles theta qpos jpos aipos aspos winkel lage stellung angulo "
        "posicion posicao posizione angolo positie hoek kat pozycja polozenie kulma asento uhel pozice "
        "位置 角度 关节角 関節角 각도 위치 угол положение"
    ),
    VELOCITY: _words(
        "qd dq qdot vel velocity velocities speed omega qvel dtheta thetadot geschwindigkeit drehzahl velocidad "
        "velocidade vitesse velocita snelheid predkosc nopeus rychlost hastighet 速度 角速度 속도 скорость"
    ),
    TORQUE: _words(
        "tau torque torques effort efforts moment moments momente trq drehmoment couple coppia koppel momento par "
        "torsion vaanto 力矩 扭矩 トルク 토크 момент"
    ),
    CURRENT: _words(
        "current currents cur curr macur i amps strom corriente corrente courant stroom prad virta proud "
        "电流 電流 전류 ток"
    ),
    OTHER: _words(
        "qdd ddq dtau ee eef acc accel acceleration beschleunigung aceleracion 加速度 ускорение tcp pose "
        "cart cartesian force kraft ft wrench gripper greifer finger image camera voltage spannung error "
        "fehler status mode safety digital analog pwm jacobian ext external extern friction reibung "
        "gravity coriolis temp temperature temperatur temperatura 温度 температура reward done contact "
        "kollision collision execution scaling speed_scaling"
    ),
}
"""Quantity -> its words, accents off."""
COMMANDED = _words(
    "target cmd command commanded aspos des desired ref reference soll sollwert setpoint goal action consigne deseada "
    "d komanda wanted vorgabe 目标 指令 задание"
)
MEASURED = _words(
    "actual act ist istwert meas measured mess gemessen real state observation obs fbk feedback aktuell aktuelle "
    "current msr link output"
)
MOTOR_SIDE = _words("motor rotor drive antrieb encoder raw")
_NUMBER = r"([_ .]?\d{1,3}|[\[(]\d{1,3}[\])])"
"""Number of a joint behind a unit, as a pattern."""
_NOT_INSIDE = frozenset(_words("time temps tempo state real link lage cart drive mode done rest moment pose goal row"))
"""Words that stand inside others with another meaning: never there."""

UNITS: dict[str, str] = {
    **dict.fromkeys(_words("rad radian radians радиан"), "rad"),
    **dict.fromkeys(_words("deg degree degrees grad grados gradi degres stopnie graden ° º 度 град"), "deg"),
    **dict.fromkeys(_words("rad/s rad/sec rad*s-1 radps rads"), "rad/s"),
    **dict.fromkeys(_words("deg/s deg/sec °/s º/s grad/s dps degps grados/s degs"), "deg/s"),
    **dict.fromkeys(_words("rpm u/min 1/min min-1 tr/min min^-1 об/мин"), "rpm"),
    **dict.fromkeys(_words("rev/s turn/s"), "turn/s"),
    **dict.fromkeys(_words("rev turn turns umdrehungen"), "turn"),
    **dict.fromkeys(_words("mrad"), "mrad"),
    **dict.fromkeys(_words("nm n·m n⋅m n*m n.m n-m newtonmeter newtonmetre нм н·м"), "N m"),
    **dict.fromkeys(_words("mnm mn·m mn*m mn.m"), "mN m"),
    **dict.fromkeys(_words("a amp amps ampere amperes"), "A"),
    **dict.fromkeys(_words("ma milliamp milliampere milliamperes"), "mA"),
    **dict.fromkeys(_words("% percent prozent pct procent"), "percent"),
    **dict.fromkeys(_words("‰ permille promille"), "permille"),
    **dict.fromkeys(_words("counts count cnt ticks tick inc increments inkremente pulses"), "counts"),
    **dict.fromkeys(_words("s sec secs second seconds sek sekunden segundos"), "s"),
    **dict.fromkeys(_words("ms msec msecs millis milliseconds millisekunden"), "ms"),
    **dict.fromkeys(_words("us usec usecs µs μs micros microseconds"), "us"),
    **dict.fromkeys(_words("ns nsec nsecs nanos nanosec nanosecs nanosecond nanoseconds"), "ns"),
}
"""Unit as written -> as it is called here."""
OF_SLIDING = {"m": "rad", "m/s": "rad/s", "n": "N m"}
"""SI unit of a joint that slides, in brackets -> that of one that turns: in a mapping this stands for both."""
OF_QUANTITY: dict[str, tuple[str, ...]] = {
    TIME: ("s", "ms", "us", "ns"),
    POSITION: ("rad", "deg", "turn", "mrad", "counts"),
    VELOCITY: ("rad/s", "deg/s", "rpm", "turn/s"),
    TORQUE: ("N m", "mN m", "percent", "permille"),
    CURRENT: ("A", "mA", "percent", "permille"),
}
"""Quantity -> the units that it can have."""


@dataclass(frozen=True)
class Meaning:
    """What a name says.

    Attributes:
        quantity: One of the quantities; None: nothing.
        unit: One of the values of `UNITS`; None: nothing.
        commanded: Whether it is a set-point.
        measured: Whether it says to be measured.
        motor_side: Whether it says to be of the motor.
        number: Number of the joint as written; None: none.
        parts: The words of the name, numbers and unit left out.
    """

    quantity: str | None
    unit: str | None
    commanded: bool
    measured: bool
    motor_side: bool
    number: int | None
    parts: tuple[str, ...]

    @property
    def stem(self) -> str:
        """The name without number and unit: what the columns of several joints share."""
        return " ".join(self.parts)


def meaning_of(name: str) -> Meaning:
    """What the name of a column says."""
    bare, unit = _without_unit(name)
    parts = _parts(bare)
    numbers = [int(part) for part in parts if part.isdecimal() and len(part) < 4]
    words = tuple(part for part in parts if not part.isdecimal())
    quantity = _quantity(words, unit)
    if unit is not None and quantity is None:
        possible = [one for one, units in OF_QUANTITY.items() if unit in units]
        quantity = possible[0] if len(possible) == 1 else None
    if unit not in OF_QUANTITY.get(quantity or "", ()):
        unit = None
    return Meaning(
        quantity,
        unit,
        any(_is(part, COMMANDED) for part in words),
        any(_is(part, MEASURED) for part in words),
        any(_is(part, MOTOR_SIDE) for part in words),
        numbers[-1] if numbers else None,
        words,
    )


@cache
def _spelled(text: str) -> str | None:
    """The unit of a text, None where it is none."""
    return UNITS.get(re.sub(r"\s+", "", _plain(text)))


def _without_unit(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit: in brackets, or behind the last underscore or space.

    The number of the joint may follow the unit (`torque_percent_1`, `angle_deg[0]`).
    """
    for found in re.finditer(r"[\[(]([^\[\]()]*)[\])]", name):
        unit = _spelled(found.group(1)) or OF_SLIDING.get(_plain(found.group(1).strip()))
        if unit is not None:
            return name[: found.start()] + " " + name[found.end() :], unit
    # Behind the last separator a single `a`, `s` or `d` may be part of the name; a written-out unit is not.
    for pattern in (
        r"[_ ./]([^\W_]+[/_](?:s|sec|min))$",
        r"[_ ./]([^\W\d_]{1,12}|%|°)$",
        rf"[_ ./]([^\W_]+[/_](?:s|sec|min)){_NUMBER}$",
        rf"[_ ./]([^\W\d_]{{2,12}}|%|°){_NUMBER}$",
    ):
        found_end = re.search(pattern, name)
        if found_end:
            unit = _spelled(found_end.group(1).replace("_", "/"))
            if unit is not None:
                return f"{name[: found_end.start()]}{''.join(found_end.groups()[1:])}", unit
    return name, None


def split_unit(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit; a name that is a unit, such as `nsec`, has nothing beside it.

    Args:
        name: The name of a column.
    """
    whole = _spelled(name)
    return ("", whole) if whole is not None else _without_unit(name)


def _parts(name: str) -> list[str]:
    """A name taken apart at punctuation, at digits, and where a capital follows a small letter."""
    apart = re.sub(r"(?<=[a-zà-þ])(?=[A-ZÀ-Þ])", " ", name)
    return re.findall(r"\d+|[^\W\d_]+", _plain(apart))


def _is(part: str, words: tuple[str, ...]) -> bool:
    return _fit(part, words) > 0


def _fit(part: str, words: tuple[str, ...]) -> int:
    """Letters of the longest word that a part is, or holds; 0 where there is none."""
    best = 0
    for word in words:
        if part == word:
            return 100 + len(word)
        long_enough = len(word) >= (_INSIDE if word.isascii() else 2)
        if long_enough and word not in _NOT_INSIDE and word in part:
            best = max(best, len(word))
    return best


def _quantity(words: tuple[str, ...], unit: str | None) -> str | None:
    """The quantity that the words name; `current` beside another quantity means now, not amperes."""
    fits = {quantity: max((_fit(part, of) for part in words), default=0) for quantity, of in WORDS.items()}
    fits = {quantity: fit for quantity, fit in fits.items() if fit}
    if not fits and {"axis", "act"} <= set(words):  # KUKA's $AXIS_ACT is the axes' actual position
        return POSITION
    if len(fits) > 1 and "current" in words and unit not in ("A", "mA") and not fits.keys() <= {CURRENT, OTHER}:
        fits.pop(CURRENT, None)
    if OTHER in fits:
        return OTHER
    if unit is not None:
        of_unit = {quantity: fit for quantity, fit in fits.items() if unit in OF_QUANTITY.get(quantity, ())}
        fits = of_unit or fits
    if len(fits) > 1 and POSITION in fits:  # `theta_dot`, `joint position velocity`: the derivative is named besides
        if "dot" in words and VELOCITY not in fits:
            return VELOCITY
        rest = {quantity: fit for quantity, fit in fits.items() if quantity != POSITION}
        fits = rest if max(rest.values()) >= fits[POSITION] else fits
    if fits.keys() == {POSITION} and "dot" in words:
        return VELOCITY
    return max(fits, key=lambda quantity: fits[quantity]) if fits else None
