"""ADF files for tests, after the format's documentation: twins of CGNS files in HDF5, in every form that the format has."""

import itertools

import h5py
import numpy as np

BLANK = b"0" * 8 + b"1000"


class Heap:
    """A file that grows. `version` is "A" (places in digits) or "B" (places in integers), `order` "<" or ">"."""

    def __init__(self, version, order):
        self.version, self.order, self.data = version, order, bytearray(266)

    def pointer(self, at):
        block, offset = divmod(at, 4096)
        if self.version == "A":
            return b"%08X%04X" % (block, offset)
        return (
            np.array([block], self.order + "u8").tobytes()
            + np.array([offset], self.order + "u4").tobytes()
        )

    def add(self, raw):
        at = len(self.data)
        self.data += raw
        return at

    def part(self, first, content, last):
        at = len(self.data)
        self.add(first + self.pointer(at + 16 + len(content)) + content + last)
        return at

    def node(self, name, label, values, children, pieces=1):
        """A node behind its children; `values` are in the order of HDF5, cut into `pieces`."""
        kind, sizes, chunks, at = b"MT", [], 0, 0
        if values is not None:
            code = values.dtype.kind.upper().replace("F", "R") + str(values.dtype.itemsize)
            kind, sizes, chunks = (
                b"C1" if values.dtype.itemsize == 1 else code.encode(),
                values.shape[::-1],
                pieces,
            )
            raw = values.astype(values.dtype.newbyteorder(self.order)).tobytes()
            counts = [
                values.size * k // pieces for k in range(pieces + 1)
            ]  # cgnslib swaps the bytes of each piece
            pairs = [
                (a * values.itemsize, b * values.itemsize) for a, b in itertools.pairwise(counts)
            ]
            parts = [self.part(b"DaTa", raw[a:b], b"dEnD") for a, b in pairs]
            ends = [at + 16 + b - a for at, (a, b) in zip(parts, pairs, strict=True)]
            table = b"".join(
                self.pointer(k) for pair in zip(parts, ends, strict=True) for k in pair
            )
            at = parts[0] if pieces == 1 else self.part(b"DCtb", table, b"dcTE")
        return name.encode().ljust(32), self.add(
            self.head(name, label, children, kind, sizes, chunks, at)
        )

    def head(self, name, label, children, kind, sizes, chunks, at):
        below = b"".join(name + self.pointer(place) for name, place in children)
        unused = (b"unused entry in sub-node-table  " + self.pointer(4096)) * 2
        table = (
            self.pointer(self.part(b"SNTb", below + unused, b"snTE"))
            if children
            else self.pointer(4096)
        )
        padded = [*sizes, *[0] * (12 - len(sizes))]
        shape = np.array(padded, self.order + "u8").tobytes()
        if self.version == "A":
            shape = b"".join(b"%08X" % size for size in padded)
        count = len(children)
        words = [
            b"NoDe",
            name.encode().ljust(32),
            label.ljust(32),
            b"%08X%08X" % (count, count + 2),
            table,
        ]
        words += [
            kind.ljust(32),
            b"%02X" % len(sizes),
            shape,
            b"%04X" % chunks,
            self.pointer(at or 4096),
            b"TaiL",
        ]
        return b"".join(words)

    def finish(self, root):
        date, letter = b"Wed Apr 19 09:33:25 1995".ljust(28), b"L" if self.order == "<" else b"B"
        what = (
            b"\300\250\243\251ADF Database Version "
            + {"A": b"A02011>", "B": b"B02012>"}[self.version]
        )
        sizes = b"010204080408" + b"08" * 5
        empty = b"".join([b"fCbt", *[self.pointer(4096)] * 6, b"Fcte"])
        places = b"".join(self.pointer(at) for at in (root, len(self.data), 186, 4096))
        head = [what, b"AdF0", date, b"AdF1", date, b"AdF2", letter, b"B", b"AdF3", sizes, b"08"]
        head += [b"AdF4", places, b"AdF5", empty]
        self.data[:266] = b"".join(head)
        return bytes(self.data)


def twin(source, path, version="A", order="<", pieces=1):
    """Writes an ADF file with the nodes of one in HDF5."""
    heap = Heap(version, order)

    def add(name, group):
        children = [
            add(key, child) for key, child in group.items() if isinstance(child, h5py.Group)
        ]
        values = group[" data"][()] if " data" in group else None
        count = pieces if values is not None and values.size >= pieces else 1
        return heap.node(name, group.attrs["label"].rstrip(b"\0"), values, children, count)

    with h5py.File(source) as file:
        children = [add(key, child) for key, child in file.items() if isinstance(child, h5py.Group)]
        root = heap.node("ADF MotherNode", b"Root Node of ADF File", None, children)[1]
    path.write_bytes(heap.finish(root))
