"""Names for extensions and their homes, for type checkers and for `jaxmorph.extend` as it runs."""

# isort: off
from collections.abc import Callable
from typing import Any

from ._advice.crossings import wall_crossings as wall_crossings
from ._host.cells.adjacency import parts_of as parts_of
from ._host.cells.lagrange import Lagrange as Lagrange, lagrange_types as lagrange_types
from ._host.cells.topology import solid as solid
from ._host.package.arguments import (
    between as between,
    checked as checked,
    finite_array as finite_array,
    real_array as real_array,
    rows_of as rows_of,
    whole as whole,
)
from ._host.package.errors import warn as warn
from ._host.package.files import (
    PathLike as PathLike,
    complete as complete,
    input_path as input_path,
    output_path as output_path,
)
from ._host.package.ranks import Agreement as Agreement, Alone as Alone, together as together
from ._host.package.rounding import Tree as Tree, spacing as spacing
from ._host.package.text import decoded as decoded, patch_names as patch_names
from ._host.rows import join_ids as join_ids
from ._host.surface.cad_sources import cad_model as cad_model
from ._host.surface.gaps import closest as closest, fans as fans
from ._kernels.callback import host_call as host_call
from ._kernels.compile import (
    by_place as by_place,
    float64_mode as float64_mode,
    quickly_compiled as quickly_compiled,
)
from ._kernels.module import Module as Module
from ._kernels.values import (
    Either as Either,
    add_at as add_at,
    area_vectors as area_vectors,
    as_jax as as_jax,
    is_known as is_known,
    namespace as namespace,
    norm as norm,
    put_at as put_at,
)

def listing(names: dict[str, Any]) -> Callable[[], list[str]]: ...
def attached(
    module: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]: ...
