"""A folder of programs for `SU2_RUN`: SU2_DEF and SU2_DOT by jaxmorph, the others SU2's own."""

import os
import pathlib
import shlex
import shutil
import sys

from jaxmorph.extend import PathLike, checked, complete

ACTIONS = {"SU2_DEF": "def", "SU2_DOT": "dot", "SU2_DOT_AD": "dot"}
"""The programs that jaxmorph stands in for, and its own commands."""

SHIM_MARK = "by jaxmorph"

WARNINGS = "warnings.txt"

# SU2's scripts run `mpirun -n N FOLDER/SU2_DEF config_DEF.cfg`, read the errors when all is done,
# and take status 1 for a failed evaluation, 2 for a flow that diverged.
SCRIPT = """\
#!/bin/sh
# {name} {mark}: written by `jaxmorph su2 shims`. Flags such as --method may follow "$@".
# Of several processes the first does the work.
rank=${{OMPI_COMM_WORLD_RANK:-${{PMI_RANK:-${{PMIX_RANK:-${{SLURM_PROCID:-0}}}}}}}}
[ "$rank" = 0 ] || exit 0
# Warnings are said once, whatever the config file is called: those in this file were.
said=$(dirname "$0")/{warnings}
touch "$said" 2>/dev/null || said=/dev/null
errors=$(mktemp) || exit 3
{python} -P -m jaxmorph su2 {action} "$@" 2>"$errors"
status=$?
if [ $status = 0 ]; then
    sed "s|warning: $1: |warning: |" "$errors" | grep -vxFf "$said" | tee -a "$said" >&2
else
    cat "$errors" >&2
fi
rm -f "$errors"
[ $status = 2 ] && status=3
exit $status
"""


@checked
def write_shims(folder: PathLike, *, programs: PathLike | None = None) -> tuple[str, ...]:
    """Writes a folder for `SU2_RUN`, with which SU2's own scripts move meshes by jaxmorph.

    It holds SU2_DEF, SU2_DOT and SU2_DOT_AD, and links to all else in SU2's folder.

    **Arguments:**

    - `folder`: the new folder, or one of an earlier call.
    - `programs`: SU2's folder. Default: `SU2_RUN`, or the one of `SU2_CFD` on the path; without
      either there are no links.

    **Returns:** the names of the programs that are links. **Raises:** `ValueError` for a folder
    that has programs of SU2, or of anybody else, under one of the three names.
    """
    folder = pathlib.Path(folder).absolute()
    source = _find_programs(folder, programs)
    for name in ACTIONS:
        file = folder / name
        if os.path.lexists(file) and SHIM_MARK.encode() not in file.read_bytes()[:200]:
            raise ValueError(f"{file} is a program of SU2: give a folder of its own.")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / WARNINGS).unlink(missing_ok=True)
    for name, action in ACTIONS.items():
        text = SCRIPT.format(
            name=name,
            mark=SHIM_MARK,
            warnings=WARNINGS,
            action=action,
            python=shlex.quote(sys.executable),
        )
        with complete(folder / name) as partial:
            partial.write_text(text, encoding="utf-8")
            partial.chmod(0o755)
    own = {*ACTIONS, WARNINGS}
    links = sorted(file for file in (source.iterdir() if source else ()) if file.name not in own)
    for file in links:
        link = folder / file.name
        if link.is_symlink():
            link.unlink()
        if not link.exists():
            link.symlink_to(file)
    return tuple(file.name for file in links if file.name.startswith("SU2_"))


def _find_programs(folder: pathlib.Path, programs: PathLike | None) -> pathlib.Path | None:
    if programs is not None:
        source = pathlib.Path(programs).absolute()
        if not source.is_dir():
            raise ValueError(f"{source}: `programs` is no folder.")
        return source
    places = [os.environ.get("SU2_RUN")]
    for solver in (shutil.which("SU2_CFD"), folder / "SU2_CFD"):  # the latter of an earlier call
        if solver is not None and os.path.exists(solver):
            places += [os.path.dirname(solver), os.path.dirname(os.path.realpath(solver))]
    for place in filter(None, places):
        source = pathlib.Path(place).absolute()
        if source.is_dir() and source != folder:
            return source
    return None
