"""Named things that a program may add to: laws of gears, effects of joints."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Generic, Protocol, TypeVar

from strainwave.errors import InvalidInput


class Named(Protocol):
    """Something with a name."""

    @property
    def name(self) -> str:
        """As in a study file."""
        ...


T = TypeVar("T", bound=Named)


class Registry(Generic[T]):
    """What is known of one kind, in the order in which it was registered."""

    def __init__(self, kind: str, article: str, key: str, known: Iterable[T]) -> None:
        """Of a kind, such as "gear law", named by a key of a study file."""
        self._kind, self._article, self._key = kind, article, key
        self._known = {one.name: one for one in known}

    def __getitem__(self, name: str) -> T:
        """The one of a name; InvalidInput where there is none."""
        if name not in self._known:
            raise InvalidInput(
                f"there is no {self._kind} {name!r}",
                where=self._key,
                remedy=f"use one of {', '.join(self._known)}",
            )
        return self._known[name]

    def names(self) -> tuple[str, ...]:
        """Of all."""
        return tuple(self._known)

    def all(self) -> tuple[T, ...]:
        """All of them."""
        return tuple(self._known.values())

    def check_new(self, name: str) -> None:
        """Whether a name is free; InvalidInput where it is not."""
        if name in self._known:
            raise InvalidInput(
                f"there is {self._article} {self._kind} {name!r} already",
                remedy="give it another name",
            )

    def add(self, one: T) -> None:
        """Make one known; its name is free."""
        self._known[one.name] = one

    def remove(self, name: str) -> None:
        """Forget one; InvalidInput where there is none of that name."""
        del self._known[self[name].name]
