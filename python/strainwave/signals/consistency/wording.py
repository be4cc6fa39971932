"""Numbers and lines of study.toml as findings quote them."""

from __future__ import annotations

from strainwave.domain import Channel, Study


def number(value: float, digits: int = 4) -> str:
    """A number with so many digits, and none more than it needs.

    Parameters
    ----------
    value : float
    digits : int

    Returns
    -------
    str
    """
    return f"{value:.{digits}g}"


def column_line(study: Study, name: str, factor: float) -> str:
    """A channel's line in [channels] with its scale multiplied by a factor.

    Parameters
    ----------
    study : Study
    name : str
    factor : float

    Returns
    -------
    str
    """
    now = study.channels.get(name) or Channel(name)
    scale = number(now.scale * factor, 7)
    offset = f", offset = {number(now.offset * factor, 7)}" if now.offset else ""
    return f'channels.{name} = {{ column = "{now.column}", scale = {scale}{offset} }}'


def scaled_line(study: Study, name: str, factor: float) -> str:
    """What to do about a channel's scale."""
    return f"Set {column_line(study, name, factor)}"


def swap_line(study: Study, kind: str) -> str:
    """What to do about two exchanged channels."""
    first, second = (study.channels.get(f"{kind}{i}") or Channel(f"{kind}{i}") for i in (1, 2))

    def line(name: str, source: Channel) -> str:
        if source.scale == 1.0 and source.offset == 0.0:
            return f'channels.{name} = "{source.column}"'
        scale = f", scale = {number(source.scale, 7)}"
        offset = f", offset = {number(source.offset, 7)}" if source.offset else ""
        return f'channels.{name} = {{ column = "{source.column}"{scale}{offset} }}'

    return f"Set {line(f'{kind}1', second)} and {line(f'{kind}2', first)}"
