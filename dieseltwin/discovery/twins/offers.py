"""What a twin may offer beside what every twin does, asked of the object itself.

From Python 3.12 on `isinstance` with a protocol no longer asks an object but looks into its class. A twin around
another one (`interface.WithSignals`), whose attributes are the other's, offered nothing of it there: half of the
search saw its open circumstances and half didn't.
"""

from __future__ import annotations

import inspect
from functools import cache
from typing import TYPE_CHECKING, Generic, Protocol

# Python's own metaclass of protocols has no public name; type checkers take protocols as having the public one.
if TYPE_CHECKING:
    from abc import ABCMeta as _OfProtocols
else:
    _OfProtocols = type(Protocol)


@cache
def _members(protocol: type) -> tuple[str, ...]:
    bases = [base for base in protocol.__mro__ if base not in (object, Protocol, Generic)]
    names = {name for base in bases for name in (*vars(base), *inspect.get_annotations(base))}
    return tuple(sorted(name for name in names if not name.startswith("_")))


class _Asked(_OfProtocols):
    def __instancecheck__(cls, instance: object) -> bool:
        if not getattr(cls, "_is_protocol", False):  # a class that carries out a protocol is asked for as any class
            return super().__instancecheck__(instance)
        return all(hasattr(instance, name) for name in _members(cls))


class Offer(Protocol, metaclass=_Asked):
    """Base of protocols whose `isinstance` asks the object for every member, in every version of Python."""
