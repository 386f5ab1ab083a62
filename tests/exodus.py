"""Exodus files for tests, after the format's manual, in all forms of netCDF; and VTK's view of them."""

import h5py
import numpy as np
import pytest
from foam import mixed
from scipy.io import netcdf_file

FORMS = ("cdf1", "cdf2", "cdf5", "netcdf4")
TYPES = {
    "triangle": "TRI3",
    "quad": "SHELL4",
    "tetra": "TETRA4",
    "pyramid": "PYRAMID",
    "wedge": "wedge6",
}
TYPES |= {"hexahedron": "HEX", "line": "BAR2"}


def names(texts):
    return np.array([list(text.ljust(33, "\0")) for text in texts], "S1").reshape(-1, 33)


def write(
    path,
    points,
    blocks,
    side_sets=(),
    node_sets=(),
    form="cdf1",
    real="f8",
    is_joined=False,
    types=TYPES,
):
    """Writes blocks (name, type, corners), side sets (name, cells, sides) and node sets (name, nodes); ids count from 0.

    `is_joined` makes one array of all coordinates, `real` their type.
    """
    total = sum(len(corners) for _, _, corners in blocks)
    sizes = {
        "num_dim": points.shape[1],
        "num_nodes": len(points),
        "num_elem": total,
        "num_el_blk": len(blocks),
    }
    sizes |= {"num_side_sets": len(side_sets), "num_node_sets": len(node_sets)}
    arrays = {f"coord{x}": values.astype(real) for x, values in zip("xyz", points.T, strict=False)}
    dimensions = {name: ["num_nodes"] for name in arrays}
    if is_joined:
        arrays, dimensions = {"coord": points.T.astype(real)}, {"coord": ["num_dim", "num_nodes"]}
    attributes = {}
    numbers = ("num_el_blk", "num_side_sets", "num_node_sets")
    for what, size, items in zip(
        ("eb", "ss", "ns"), numbers, (blocks, side_sets, node_sets), strict=True
    ):
        if items:
            arrays[f"{what}_status"] = np.array([len(each[-1]) > 0 for each in items], "i4")
            arrays[f"{what}_prop1"] = 10 * np.arange(1, len(items) + 1, dtype="i4")
            attributes[f"{what}_prop1"] = {"name": "ID"}
            arrays[f"{what}_names"] = names([each[0] for each in items])
            dimensions |= {
                f"{what}_status": [size],
                f"{what}_prop1": [size],
                f"{what}_names": [size, "len_name"],
            }
    for at, (_, kind, corners) in enumerate(blocks, start=1):
        arrays[f"connect{at}"] = np.asarray(corners, "i4") + 1
        dimensions[f"connect{at}"] = [f"num_el_in_blk{at}", f"num_nod_per_el{at}"]
        attributes[f"connect{at}"] = {"elem_type": types[kind]}
    for at, (_, cells, sides) in enumerate(side_sets, start=1):
        for what, ids in (("elem", cells), ("side", sides)):
            arrays[f"{what}_ss{at}"] = np.asarray(ids, "i4") + 1
            dimensions[f"{what}_ss{at}"] = [f"num_side_ss{at}"]
    for at, (_, nodes) in enumerate(node_sets, start=1):
        arrays[f"node_ns{at}"] = np.asarray(nodes, "i4") + 1
        dimensions[f"node_ns{at}"] = [f"num_nod_ns{at}"]
    arrays = {
        name: array for name, array in arrays.items() if array.size
    }  # an empty set has no arrays
    for name, array in arrays.items():
        sizes |= dict(zip(dimensions[name], array.shape, strict=True))
    attributes[""] = {"api_version": np.float32(5.1), "version": np.float32(5.1)}
    attributes[""] |= {
        "floating_point_word_size": np.int32(8),
        "file_size": np.int32(not is_joined),
    }
    {"netcdf4": _netcdf4, "cdf5": _cdf5}.get(form, _classic)(
        path, sizes, arrays, dimensions, attributes, form
    )


CELLS = {
    "hexahedron": [[0, 1, 2, 3, 4, 5, 6, 7]],
    "wedge": [[1, 8, 2, 5, 9, 6]],
    "pyramid": [[4, 5, 6, 7, 10]],
    "tetra": [[6, 11, 7, 10]],
}
SIDES = [6, 5, 5, 4]
"""How many sides each cell has."""


def solid(path, **form):
    """Cells of all types in blocks, shells on two of their faces, and a set of each side of each cell; returns the path."""
    points = mixed()[0]
    blocks = [(f"all {kind}", kind, corners) for kind, corners in CELLS.items()]
    blocks += [("skin", "quad", [[0, 3, 2, 1]]), ("tip", "triangle", [[6, 11, 10]])]
    sets = [
        (f"side {cell} {side}", [cell], [side])
        for cell, count in enumerate(SIDES)
        for side in range(count)
    ]
    sets += [
        ("several", [0, 3, 1], [4, 0, 3]),
        ("of shells", [4, 4, 5, 5], [0, 3, 1, 4]),
        ("none", [], []),
    ]
    write(path, points, blocks, sets, [("floor", [0, 1, 2, 3, 8]), ("corner", [11])], **form)
    return path


def _classic(path, sizes, arrays, dimensions, attributes, form):
    with netcdf_file(path, "w", version=int(form[3])) as file:
        for name, value in attributes[""].items():
            setattr(file, name, value)
        file.createDimension("time_step", None)
        for name, size in sizes.items():
            file.createDimension(name, size)
        time = file.createVariable("time_whole", "d", ("time_step",))
        field = file.createVariable("vals_nod_var1", "d", ("time_step", "num_nodes"))
        for step in range(2):
            time[step] = step
            field[step] = np.arange(sizes["num_nodes"]) + step
        for name, array in arrays.items():
            variable = file.createVariable(name, array.dtype, tuple(dimensions[name]))
            variable[...] = array
            for key, value in attributes.get(name, {}).items():
                setattr(variable, key, value)


def _netcdf4(path, sizes, arrays, dimensions, attributes, form):
    """HDF5 as netCDF-4 lays it out: dimensions are data sets, to which others refer."""
    with h5py.File(path, "w", track_order=True, libver=("v108", "v108")) as file:
        for name, value in attributes[""].items():
            file.attrs[name] = np.array([value])
        for number, (name, size) in enumerate(sizes.items()):
            scale = file.create_dataset(name, (size,), ">f4", track_order=True)
            scale.make_scale(f"This is a netCDF dimension but not a netCDF variable.{size:10d}")
            scale.attrs["_Netcdf4Dimid"] = np.int32(number)
        for name, array in arrays.items():
            item = file.create_dataset(name, data=array, track_order=True)
            for axis, size in enumerate(dimensions[name]):
                item.dims[axis].attach_scale(file[size])
            for key, value in attributes.get(name, {}).items():
                item.attrs[key] = np.bytes_(value)


def _cdf5(path, sizes, arrays, dimensions, attributes, form):
    number = lambda value, width=8: int(value).to_bytes(width, "big")  # noqa: E731
    padded = lambda data: data + b"\0" * (-len(data) % 4)  # noqa: E731
    text = lambda word: number(len(word)) + padded(word.encode())  # noqa: E731
    codes = {"S1": 2, "i4": 4, "f4": 5, "f8": 6}

    def listed(tag, items):
        return number(tag if items else 0, 4) + number(len(items)) + b"".join(items)

    def told(values):
        return listed(12, [text(key) + number(2, 4) + text(value) for key, value in values.items()])

    raw = {
        name: padded(array.astype(array.dtype.newbyteorder(">")).tobytes())
        for name, array in arrays.items()
    }
    order = list(sizes)

    def header(places):
        variables = [
            text(name) + number(array.ndim) + b"".join(number(order.index(size)) for size in dimensions[name])
            + told(attributes.get(name, {})) + number(codes[array.dtype.str[1:]], 4)
            + number(len(raw[name])) + number(places.get(name, 0))
            for name, array in arrays.items()
        ]  # fmt: skip
        values = [
            text(name)
            + number(codes[value.dtype.str[1:]], 4)
            + number(1)
            + padded(value.byteswap().tobytes())
            for name, value in attributes[""].items()
        ]
        size_list = listed(10, [text(name) + number(sizes[name]) for name in order])
        return b"CDF\5" + number(0) + size_list + listed(12, values) + listed(11, variables)

    at, places = len(header({})), {}
    for name, data in raw.items():
        places[name], at = at, at + len(data)
    path.write_bytes(header(places) + b"".join(raw.values()))


def of_vtk(path):
    """Corners of the cells of each block and set as VTK reads them, by what it is and its name: their places, and ids."""
    exodus = pytest.importorskip("vtkmodules.vtkIOExodus")
    from vtkmodules.util.numpy_support import vtk_to_numpy as numpy_of
    from vtkmodules.vtkCommonCore import vtkObject
    from vtkmodules.vtkCommonDataModel import vtkCompositeDataSet

    vtkObject.GlobalWarningDisplayOff()  # a file without steps of time
    reader = exodus.vtkExodusIIReader()
    reader.SetFileName(str(path))
    reader.SetSqueezePoints(False)  # in single precision otherwise
    reader.UpdateInformation()
    kinds = {"blocks": reader.ELEM_BLOCK, "sides": reader.SIDE_SET, "nodes": reader.NODE_SET}
    for kind in kinds.values():
        for at in range(reader.GetNumberOfObjects(kind)):
            reader.SetObjectStatus(kind, at, 1)
    reader.GenerateGlobalNodeIdArrayOff()
    reader.Update()
    groups = reader.GetOutput()
    found = {}
    for name, at in (("blocks", 0), ("sides", 4), ("nodes", 7)):
        group = groups.GetBlock(at)
        for k in range(group.GetNumberOfBlocks()):
            grid = group.GetBlock(k)
            if grid is None or not grid.GetNumberOfPoints():
                continue
            label = group.GetMetaData(k).Get(vtkCompositeDataSet.NAME())
            places = numpy_of(grid.GetPoints().GetData())
            corners = numpy_of(grid.GetCells().GetConnectivityArray())
            found[name, label.split(" ID:")[0]] = places[corners], corners
    return found
