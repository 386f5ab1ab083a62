"""Meshes from files and into files: everything but the coordinates as it was."""

import typing

from jaxmorph._host.package.names import Names

if typing.TYPE_CHECKING:
    from ._public import *  # noqa: F403

_names = Names(__name__)
__getattr__, __dir__ = _names.found, _names.listed
