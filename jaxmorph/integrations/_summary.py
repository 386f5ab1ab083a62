"""The quality of a mesh in pieces, summed up over the processes of an MPI run."""

import dataclasses
from typing import Any

import numpy as np

import jaxmorph as jm


@dataclasses.dataclass(frozen=True)
class Summary:
    """Sums up the quality of a mesh in pieces.

    Faces between two pieces are not judged: a piece's non-orthogonality is that of the faces inside
    it.

    - `cells`, `inverted`, `degenerate`: how many.
    - `smallest`, `largest`, `mean`: of each measure of `QualityReport`, means weighted by area or
      volume.
    """

    cells: int
    inverted: int
    degenerate: int
    smallest: dict[str, float]
    largest: dict[str, float]
    mean: dict[str, float]

    @classmethod
    def gathered(cls, comm: Any, report: jm.QualityReport) -> "Summary":
        """Sums up the reports of all processes; each cell is in one of them."""
        size = np.asarray(report.volume)[report.counted]
        names = ("skewness", "aspect_ratio", "non_orthogonality", "volume", "jacobian_ratio")
        values = {name: np.asarray(getattr(report, name))[report.counted] for name in names}
        counts = len(size), int(report.inverted), int(report.degenerate)
        least = {name: float(column.min(initial=np.inf)) for name, column in values.items()}
        most = {name: float(column.max(initial=-np.inf)) for name, column in values.items()}
        sums = {name: float((column * size).sum()) for name, column in values.items()}
        shares = comm.allgather((counts, least, most, sums, float(size.sum())))
        whole = sum(share[4] for share in shares)
        return cls(
            *(sum(share[0][k] for share in shares) for k in range(3)),
            smallest={name: float(np.min([share[1][name] for share in shares])) for name in names},
            largest={name: float(np.max([share[2][name] for share in shares])) for name in names},
            mean={name: sum(share[3][name] for share in shares) / whole if whole else float("nan") for name in names},
        )
