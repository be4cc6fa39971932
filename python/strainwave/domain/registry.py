"""Registry of what a study file names and users can extend: arm kinds, gear laws, effects."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Generic, Protocol, TypeVar

from strainwave.errors import InvalidInput


class Named(Protocol):
    """An object with a name."""

    @property
    def name(self) -> str:
        """Name in a study file."""
        ...


T = TypeVar("T", bound=Named)


class Registry(Generic[T]):
    """Objects of one kind, in the order of registration."""

    def __init__(self, kind: str, article: str, key: str, entries: Iterable[T]) -> None:
        """Registry of a kind such as "gear law", which a key of the study file names."""
        self._kind, self._article, self._key = kind, article, key
        self._entries = {entry.name: entry for entry in entries}

    def __getitem__(self, name: str) -> T:
        """Entry with a name. Raises InvalidInput if there is none."""
        if name not in self._entries:
            raise InvalidInput(
                f"there is no {self._kind} {name!r}",
                where=self._key,
                remedy=f"use one of {', '.join(self._entries)}",
            )
        return self._entries[name]

    def names(self) -> tuple[str, ...]:
        """Names of all entries."""
        return tuple(self._entries)

    def all(self) -> tuple[T, ...]:
        """All entries."""
        return tuple(self._entries.values())

    def check_new(self, name: str) -> None:
        """Raise InvalidInput if a name is already in use."""
        if name in self._entries:
            raise InvalidInput(
                f"{self._article} {self._kind} {name!r} exists already",
                remedy="choose another name",
            )

    def add(self, entry: T) -> None:
        """Add an entry. Raises InvalidInput if its name is taken."""
        self.check_new(entry.name)
        self._entries[entry.name] = entry

    def remove(self, name: str) -> None:
        """Remove an entry. Raises InvalidInput if there is none of that name."""
        del self._entries[self[name].name]
