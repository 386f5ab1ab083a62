"""The meshes and motions of rows.py: small generated ones of every kind, in 2-D and 3-D, each motion with a free amount."""

import dataclasses
from collections.abc import Callable, Iterator

import faults
import numpy as np
from matplotlib.path import Path
from scipy.spatial import Delaunay, KDTree

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph.cases._meshes import block_ids, geometric, hexahedra, quads

Motion = Callable[[np.ndarray], np.ndarray]
"""Displacements (m, d) of the moving nodes (m, d) in the body's own units, for an amount of one."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A mesh, its patches, the planes in which nodes slide, and motions by name; all but rotations grow with the amount."""

    name: str
    mesh: jm.Mesh
    moving: tuple[str, ...]
    fixed: tuple[str, ...]
    motions: dict[str, Callable[[np.ndarray, float], np.ndarray]]
    symmetry: tuple[str, ...] = ()

    @property
    def base(self) -> np.ndarray:
        return np.asarray(self.mesh.points)[self.mesh.patch(*self.moving)]

    def prepared(self, method: jm.AbstractMethod | None, whole: bool) -> jm.Plan:
        """Prepares a plan with the mesh, or with its points alone."""
        mesh = self.mesh
        planes = [jm.Plane.through(mesh.points, mesh.patch(name)) for name in self.symmetry]
        if whole:
            return jm.prepare(mesh, self.moving, self.fixed, symmetry=planes, method=method)
        return jm.prepare(
            mesh.points,
            mesh.patch(*self.moving),
            mesh.patch(*self.fixed),
            symmetry=planes,
            method=method,
        )


def along(axis: int, height: np.ndarray, dimension: int) -> np.ndarray:
    return height[:, None] * np.eye(dimension)[axis]


def linear(shape: Motion) -> Callable[[np.ndarray, float], np.ndarray]:
    return lambda base, amount: amount * shape(base)


def turn(
    base: np.ndarray, radians: np.ndarray | float, centre: tuple[float, float], axes=(0, -1)
) -> np.ndarray:
    """Turns in the plane of two axes about a centre, by an angle for each node."""
    u, (a, b) = np.zeros_like(base), axes
    z = (base[:, a] - centre[0] + 1j * (base[:, b] - centre[1])) * (
        np.exp(-1j * np.asarray(radians)) - 1
    )
    u[:, a], u[:, b] = z.real, z.imag
    return u


def smooth(t: np.ndarray) -> np.ndarray:
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


SECTION: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "camber": linear(lambda x: along(-1, 0.4 * x[:, 0] * (1 - x[:, 0]), x.shape[1])),
    "thickness": linear(lambda x: along(-1, x[:, -1], x.shape[1])),
    "bump": linear(
        lambda x: along(
            -1, 0.1 * np.exp(-(((x[:, 0] - 0.5) / 0.12) ** 2)) * (x[:, -1] > 0), x.shape[1]
        )
    ),
    "waves": linear(lambda x: along(-1, 0.05 * np.sin(4 * np.pi * x[:, 0]), x.shape[1])),
    "pitch": lambda x, amount: turn(x, 0.3 * amount, (0.25, 0.0)),
    "flap": lambda x, amount: turn(x, 0.4 * amount * smooth((x[:, 0] - 0.65) / 0.1), (0.7, 0.0)),
    "nose droop": linear(
        lambda x: along(-1, -0.1 * np.clip(0.3 - x[:, 0], 0, 1) ** 2 / 0.09, x.shape[1])
    ),
    "stretch": linear(lambda x: along(0, 0.3 * (x[:, 0] - 0.3), x.shape[1])),
}
"""Changes of an airfoil of unit chord, in 2-D or section by section."""

SPAN: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "bend": linear(lambda x: along(-1, 0.3 * (x[:, 1] / x[:, 1].max()) ** 2, 3)),
    "twist": lambda x, amount: turn(x, 0.4 * amount * x[:, 1] / x[:, 1].max(), (0.5, 0.0)),
    "taper": linear(lambda x: along(-1, -0.5 * x[:, -1] * x[:, 1] / x[:, 1].max(), 3)),
}
"""Changes along the span, from a root that rests."""


def polar(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The angle about the last axis but the span, and the direction outwards in the plane of the first two coordinates."""
    out = x[:, :2] / np.linalg.norm(x[:, :2], axis=1)[:, None]
    return np.arctan2(x[:, 1], x[:, 0]), out


def outwards(
    height: Callable[[np.ndarray], np.ndarray],
) -> Callable[[np.ndarray, float], np.ndarray]:
    """Moves a round wall along its own normal by a function of the angle."""

    def shape(x):
        angle, out = polar(x)
        return np.pad(height(angle)[:, None] * out, ((0, 0), (0, x.shape[1] - 2)))

    return linear(shape)


ROUND: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "lobes 3": outwards(lambda a: 0.2 * np.cos(3 * a)),
    "lobes 6": outwards(lambda a: 0.1 * np.cos(6 * a)),
    "ellipse": outwards(lambda a: 0.3 * np.cos(2 * a)),
    "dent": outwards(lambda a: -0.2 * np.exp(-((a / 0.4) ** 2))),
    "shift": linear(lambda x: along(0, np.full(len(x), 0.3), x.shape[1])),
    "growth": outwards(lambda a: np.full(len(a), 0.3)),
}


def floor(axes: tuple[int, ...]) -> dict[str, Callable[[np.ndarray, float], np.ndarray]]:
    """Changes of a flat wall across itself; they vanish at its border but for the last two."""

    def window(x):
        s = (x - x.min(axis=0)) / np.maximum(np.ptp(x, axis=0), 1e-12)
        return np.prod([4 * s[:, k] * (1 - s[:, k]) for k in axes], axis=0), s

    return {
        "hump": linear(lambda x: along(-1, 0.3 * window(x)[0] ** 2, x.shape[1])),
        "ripple": linear(
            lambda x: along(
                -1, 0.2 * window(x)[0] * np.sin(3 * np.pi * window(x)[1][:, 0]), x.shape[1]
            )
        ),
        "raise": linear(lambda x: along(-1, np.full(len(x), 0.2), x.shape[1])),
        "tilt": linear(lambda x: along(-1, 0.2 * window(x)[1][:, 0], x.shape[1])),
    }


def ring(
    inner: np.ndarray, outer: np.ndarray, share: np.ndarray
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Makes an O-grid between two closed curves (k, 2), divided as `share` says, and its quads."""
    places = inner[None] + share[:, None, None] * (outer - inner)[None]
    ids = block_ids(len(share), len(inner))
    closed = np.column_stack([ids, ids[:, 0]])[:, ::-1]
    return places.reshape(-1, 2), {"quad": quads(closed), "inner": ids[0], "outer": ids[-1]}


def o_grid(
    around: int, layers: int, first: float, far: float, shape: Motion | None = None
) -> jm.Mesh:
    """An O-grid about a circle of radius one, or about a closed curve made from it."""
    angle = 2 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points, parts = ring(
        circle if shape is None else shape(circle),
        far * circle,
        geometric(layers, first / (far - 1)),
    )
    return jm.Mesh(
        points, {"quad": parts["quad"]}, {"body": parts["inner"], "farfield": parts["outer"]}
    )


def extruded(
    flat: jm.Mesh,
    stations: int,
    span: float,
    chord: Callable[[np.ndarray], np.ndarray] | None = None,
) -> jm.Mesh:
    """Repeats a mesh of quads along y, its second coordinate becomes z; patches `root` and `tip` are the end planes."""
    eta, n = np.linspace(0, 1, stations), len(flat.points)
    size = np.ones(stations) if chord is None else chord(eta)
    x, z = (size[:, None] * np.asarray(flat.points)[:, k][None] for k in range(2))
    places = np.stack([x, np.broadcast_to(span * eta[:, None], x.shape), z], axis=-1).reshape(-1, 3)
    layers = np.asarray(flat.cells["quad"]) + n * np.arange(stations)[:, None, None]
    corners = np.concatenate([layers[1:], layers[:-1]], axis=-1).reshape(-1, 8)
    ids = block_ids(stations, n)
    patches = {name: ids[:, np.asarray(nodes)].ravel() for name, nodes in flat.patches.items()}
    return jm.Mesh(places, {"hexahedron": corners}, patches | {"root": ids[0], "tip": ids[-1]})


def upright(motions: dict[str, Callable[[np.ndarray, float], np.ndarray]]):
    """Motions in the plane of x and z of bodies that are extruded along y."""

    def lifted(motion):
        def moved(x, amount):
            return motion(x[:, [0, 2, 1]], amount)[:, [0, 2, 1]]

        return moved

    return {name: lifted(motion) for name, motion in motions.items()}


def triangles(
    bodies: dict[str, np.ndarray], box: tuple[float, float, float, float], size: float
) -> jm.Mesh:
    """Triangles around closed curves (k, 2) in a box, with four layers round each curve that grow by a half."""
    rng, layers = np.random.default_rng(5), []
    for curve in bodies.values():
        centre = curve.mean(axis=0)
        out = curve - centre
        step = (
            np.linalg.norm(np.roll(curve, -1, axis=0) - curve, axis=1).mean()
            / np.linalg.norm(out, axis=1).mean()
        )
        layers.append([centre + out * (1 + step * (1.3**j - 1) / 0.6) for j in range(5)])
    x0, x1, y0, y1 = box
    nx, ny = (max(3, round(length / size)) for length in (x1 - x0, y1 - y0))
    gx, gy = np.meshgrid(np.linspace(x0, x1, nx + 1), np.linspace(y0, y1, ny + 1), indexing="ij")
    grid = np.stack([gx.ravel(), gy.ravel()], axis=1)
    rim = (grid[:, 0] == x0) | (grid[:, 0] == x1) | (grid[:, 1] == y0) | (grid[:, 1] == y1)
    border = grid[rim]
    grid = grid[~rim] + rng.uniform(-0.15, 0.15, (int((~rim).sum()), 2)) * size
    near = np.concatenate([layer for body in layers for layer in body])
    keep = KDTree(near).query(grid)[0] > 0.6 * size
    for body in layers:
        keep &= Delaunay(body[-1]).find_simplex(grid) < 0
    points = np.concatenate([near, border, grid[keep]])
    cells = Delaunay(points).simplices
    middle = points[cells].mean(axis=1)
    inside = np.zeros(len(cells), dtype=bool)
    for curve in bodies.values():
        inside |= Delaunay(curve).find_simplex(middle) >= 0
    cells = cells[~inside]
    a, b, c = (points[cells[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    cells = np.where(area[:, None] < 0, cells[:, ::-1], cells)[np.abs(area) > 1e-9 * size**2]
    patches, start = {}, 0
    for name, body in zip(bodies, layers, strict=True):
        patches[name] = np.arange(start, start + len(body[0]))
        start += 5 * len(body[0])
    patches["farfield"] = np.arange(len(near), len(near) + len(border))
    return jm.Mesh(points, {"triangle": cells}, patches)


def blocks(
    axes: list[np.ndarray], is_solid: Callable[..., np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Makes the grid between axes without the cells whose middle is solid: points, and cells."""
    ids = block_ids(*map(len, axes))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    cells = quads(ids)[:, ::-1] if len(axes) == 2 else hexahedra(ids)[:, [4, 5, 6, 7, 0, 1, 2, 3]]
    cells = cells[~is_solid(*places[cells].mean(axis=1).T)]
    used, cells = np.unique(cells, return_inverse=True)
    return places[used], cells.reshape(-1, 2 ** len(axes))


def boxed(
    axes: list[np.ndarray], low: list[float], high: list[float], name: str = "body"
) -> jm.Mesh:
    """A box with a rectangular body in it, which may stand on a side; patches `body` and `sides`."""
    tiny = 1e-9

    def is_solid(*middle):
        return np.all(
            [(m > a) & (m < b) for m, a, b in zip(middle, low, high, strict=True)], axis=0
        )

    points, cells = blocks(axes, is_solid)
    inside = np.all((points > np.array(low) - tiny) & (points < np.array(high) + tiny), axis=1)
    ends = np.array([[axis[0], axis[-1]] for axis in axes])
    rim = ((np.abs(points - ends[:, 0]) < tiny) | (np.abs(points - ends[:, 1]) < tiny)).any(axis=1)
    kind = {2: "quad", 3: "hexahedron"}[len(axes)]
    return jm.Mesh(
        points, {kind: cells}, {name: np.flatnonzero(inside & ~rim), "sides": np.flatnonzero(rim)}
    )


def axis(low: float, high: float, body: tuple[float, float], spacing: float) -> np.ndarray:
    """Coordinates with the body's ends among them; the spacing doubles away from the body."""
    inner = np.linspace(*body, max(2, round((body[1] - body[0]) / spacing)) + 1)

    def beyond(length):
        count = max(2, int(np.ceil(np.log2(1 + length / spacing) * 2)))
        return length * geometric(count, min(spacing / length, 1 / count))

    parts = [body[0] - beyond(body[0] - low)[:0:-1]] if body[0] > low else []
    parts += [inner]
    parts += [body[1] + beyond(high - body[1])[1:]] if body[1] < high else []
    return np.concatenate(parts)


def shells(count: int, layers: int, first: float, far: float) -> jm.Mesh:
    """Hexahedra between two spheres: the surface of a cube of count x count squares a side, blown up."""
    t = np.tan(np.linspace(-np.pi / 4, np.pi / 4, count + 1))
    a, b = (x.ravel() for x in np.meshgrid(t, t, indexing="ij"))
    one = np.ones_like(a)
    sides = [(one, a, b), (-one, b, a), (b, one, a), (a, -one, b), (a, b, one), (b, a, -one)]
    places = np.concatenate([np.stack(side, axis=1) for side in sides])
    places /= np.linalg.norm(places, axis=1)[:, None]
    _, first_of, same = np.unique(
        np.round(places, 9), axis=0, return_index=True, return_inverse=True
    )
    places = places[first_of]
    flat = block_ids(count + 1, count + 1)
    corners = np.stack(
        [flat[:-1, :-1], flat[1:, :-1], flat[1:, 1:], flat[:-1, 1:]], axis=-1
    ).reshape(-1, 4)
    corners = np.concatenate([same.ravel()[corners + k * flat.size] for k in range(6)])
    radius = 1 + (far - 1) * geometric(layers, first / (far - 1))
    points = (radius[:, None, None] * places[None]).reshape(-1, 3)
    n = len(places)
    low = corners[None] + n * np.arange(layers)[:, None, None]
    cells = np.concatenate([low, low + n], axis=-1).reshape(-1, 8)
    return jm.Mesh(
        points, {"hexahedron": cells}, {"body": np.arange(n), "farfield": np.arange(n) + layers * n}
    )


def circle(count: int, centre: tuple[float, float], radius: float) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return np.array(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def one_of(
    bodies: dict[str, np.ndarray],
    name: str,
    motion: Callable[[np.ndarray, float], np.ndarray],
    mesh: jm.Mesh,
):
    """A motion of one of several bodies that are one moving boundary; all other bodies rest."""
    nodes = mesh.patch(*bodies)
    own = np.isin(nodes, mesh.patch(name))
    centre = bodies[name].mean(axis=0)

    def moved(x, amount):
        u = np.zeros_like(x)
        u[own] = motion(x[own] - centre, amount)
        return u

    return moved


def flat_cases() -> Iterator[Case]:
    far = ("farfield",)
    yield Case("C-grid 0015", cases.naca0015(points=2000), ("airfoil",), far, SECTION)
    yield Case(
        "C-grid 4412, thin cells",
        cases.naca4("4412", points=2000, first_cell=1e-6),
        ("airfoil",),
        far,
        SECTION,
    )
    yield Case(
        "C-grid 0012, sharp",
        cases.naca4("0012", points=2000, first_cell=1e-5, sharp=True),
        ("airfoil",),
        far,
        SECTION,
    )
    yield Case(
        "C-grid 0006, sharp",
        cases.naca4("0006", points=2000, first_cell=1e-4, sharp=True),
        ("airfoil",),
        far,
        SECTION,
    )
    yield Case(
        "O-grid, sharp",
        faults.sharp_o_grid(around=96, layers=32, first_cell=1e-5),
        ("airfoil",),
        far,
        SECTION,
    )
    yield Case("O-grid, circle", o_grid(112, 24, 0.04, 20.0), ("body",), far, ROUND)
    three = {
        "a": circle(40, (0.0, 0.0), 1.0),
        "b": circle(40, (3.2, 0.5), 1.0),
        "c": circle(40, (1.2, 3.0), 1.0),
    }
    mesh = triangles(three, (-4.0, 7.0, -4.0, 7.0), 0.45)
    motions = {
        f"{name} of one": one_of(three, "a", ROUND[name], mesh)
        for name in ("ellipse", "lobes 3", "shift", "growth")
    }
    motions["shift together"] = ROUND["shift"]
    yield Case("three round bodies", mesh, tuple(three), far, motions)
    two = {"a": circle(40, (0.0, 0.0), 1.0), "b": circle(40, (2.6, 0.0), 1.0)}
    mesh = triangles(two, (-4.0, 6.0, -4.0, 4.0), 0.4)
    base = {name: ROUND[name] for name in ("ellipse", "lobes 3", "shift", "dent", "growth")}
    yield Case("a round body beside a held one", mesh, ("a",), ("b", "farfield"), base)
    pins = {f"pin {k}": circle(28, (2.0 * k, 0.0), 0.5) for k in range(3)}
    mesh = triangles(pins, (-1.5, 5.5, -1.0, 1.0), 0.2)
    motions = {
        f"{name} of one": one_of(pins, "pin 1", ROUND[name], mesh)
        for name in ("ellipse", "shift", "growth")
    }
    yield Case("pins between walls", mesh, tuple(pins), far, motions)
    angle = 2 * np.pi * np.arange(80) / 80
    ones = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points, parts = ring(ones, 1.3 * ones + np.array([0.05, 0]), faults.two_sided(10, 0.03))
    rod = jm.Mesh(
        points, {"quad": parts["quad"]}, {"body": parts["inner"], "farfield": parts["outer"]}
    )
    slight = {name: ROUND[name] for name in ("ellipse", "lobes 3", "lobes 6", "shift", "dent")}
    yield Case("rod in a sleeve", rod, ("body",), far, slight)
    yield from joined_cases()
    blade = faults.cascade(around=80, layers=20, first_cell=1e-3)
    sides = ("inlet", "outlet", "lower", "upper")
    yield Case(
        "cascade",
        blade,
        ("blade",),
        sides,
        {name: SECTION[name] for name in ("camber", "thickness", "bump", "pitch", "stretch")},
    )
    plate = boxed(
        [axis(-3, 4, (0.0, 1.0), 0.05), axis(-3, 3, (-0.02, 0.02), 0.01)], [0, -0.02], [1, 0.02]
    )
    names = ("camber", "pitch", "flap", "waves")
    yield Case("thin plate", plate, ("body",), ("sides",), {name: SECTION[name] for name in names})
    yield Case("triangles, sharp airfoil", around(profile(60)), ("airfoil",), far, SECTION)


def profile(count: int, thickness: float = 0.12) -> np.ndarray:
    """A sharp symmetric section of unit chord, from its trailing edge over the upper side."""
    x = (1 + np.cos(np.linspace(0, 2 * np.pi, 2 * count + 1)[:-1])) / 2
    height = (
        5
        * thickness
        * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    )
    return np.stack([x, np.where(np.arange(2 * count) < count, 1, -1) * height], axis=1)


def around(curve: np.ndarray) -> jm.Mesh:
    """Triangles about a section: an unstructured fan of rings, coarser outwards, that Delaunay joins."""
    centre, rng = np.array([0.5, 0.0]), np.random.default_rng(3)
    rings, radius = [curve], 0.65
    close = Path(np.concatenate([curve, curve[:1]]))
    while radius < 20:
        count = max(24, int(2 * np.pi * radius / (0.06 + 0.12 * radius)))
        angle = 2 * np.pi * (np.arange(count) + rng.uniform(0, 1)) / count
        rings.append(centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
        radius *= 1.13
    x, y = np.meshgrid(np.arange(-0.15, 1.15, 0.03), np.arange(-0.63, 0.63, 0.03), indexing="ij")
    cloud = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-0.006, 0.006, (x.size, 2))
    cloud = cloud[(np.linalg.norm(cloud - centre, axis=1) < 0.62) & ~close.contains_points(cloud)]
    cloud = cloud[KDTree(curve).query(cloud)[0] > 0.02]
    outer = centre + 20.0 * np.stack(
        [np.cos(t := 2 * np.pi * np.arange(40) / 40), np.sin(t)], axis=1
    )
    points = np.concatenate([curve, cloud, *rings[1:], outer])
    points = points[np.sort(np.unique(np.round(points, 12), axis=0, return_index=True)[1])]
    cells = Delaunay(points).simplices
    cells = cells[
        ~close.contains_points(points[cells].mean(axis=1)) | (cells >= len(curve)).any(axis=1)
    ]
    a, b, c = (points[cells[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    cells = np.where(area[:, None] < 0, cells[:, ::-1], cells)[np.abs(area) > 1e-12]
    return jm.Mesh(
        points,
        {"triangle": cells},
        {"airfoil": np.arange(len(curve)), "farfield": np.arange(len(points) - 40, len(points))},
    )


def joined_cases() -> Iterator[Case]:
    """Moving walls that meet held ones: a channel, a nozzle, a flap on a wall, a hinged tail."""
    mesh = faults.channel(columns=40, rows=16, gap=0.3, first_cell=0.005)
    yield Case(
        "channel",
        mesh,
        ("inner",),
        ("outer", "inlet", "outlet"),
        floor((0,))
        | {
            "raise, blended": linear(
                lambda x: along(-1, 0.1 * smooth(x[:, 0] / 0.2) * smooth((1 - x[:, 0]) / 0.2), 2)
            )
        },
    )
    x, t = np.linspace(0, 1, 41), faults.two_sided(16, 0.01)
    top = 0.25 + 0.3 * (x - 0.45) ** 2
    points = np.stack([np.repeat(x, 17).reshape(41, 17), top[:, None] * t[None]], axis=-1)
    ids = block_ids(41, 17)
    nozzle = jm.Mesh(
        points.reshape(-1, 2),
        {"quad": quads(ids)[:, ::-1]},
        {"wall": ids[1:-1, -1], "axis": ids[:, 0], "ends": np.union1d(ids[0], ids[-1])},
    )
    wide = {
        "widened": linear(lambda x: along(-1, 0.1 * np.sin(np.pi * x[:, 0]) ** 2, 2)),
        "throat moved": linear(lambda x: along(-1, 0.1 * np.sin(2 * np.pi * x[:, 0]), 2)),
        "opened": linear(lambda x: along(-1, 0.1 * x[:, 0], 2)),
    }
    yield Case("nozzle, axis held", nozzle, ("wall",), ("axis", "ends"), wide)
    yield Case("nozzle, axis slides", nozzle, ("wall",), ("ends",), wide, ("axis",))
    grid = boxed(
        [axis(-2, 3, (0.45, 0.55), 0.025), axis(0, 2, (0.0, 1.0), 0.05)], [0.45, 0.0], [0.55, 1.0]
    )
    bent = {
        "bend": linear(lambda x: along(0, 0.3 * x[:, 1] ** 2, 2)),
        "lean": linear(lambda x: along(0, 0.3 * x[:, 1], 2)),
        "grow": linear(lambda x: along(1, 0.3 * x[:, 1], 2)),
        "wave": linear(lambda x: along(0, 0.1 * np.sin(np.pi * x[:, 1]) * x[:, 1], 2)),
    }
    yield Case("flap on a wall", grid, ("body",), ("sides",), bent)
    whole = cases.naca0015(points=2000)
    wall = whole.patch("airfoil")
    behind = np.asarray(whole.points)[wall, 0] > 0.7
    patches = {"tail": wall[behind], "front": wall[~behind], "farfield": whole.patch("farfield")}
    tail = {
        "bend": linear(lambda x: along(-1, 0.1 * ((x[:, 0] - 0.7) / 0.3) ** 2, 2)),
        "camber": linear(lambda x: along(-1, 0.2 * (x[:, 0] - 0.7) * (1 - x[:, 0]) / 0.09, 2)),
        "thickness": linear(lambda x: along(-1, x[:, 1] * smooth((x[:, 0] - 0.7) / 0.15), 2)),
    }
    yield Case(
        "hinged tail",
        jm.Mesh(whole.points, whole.cells, patches),
        ("tail",),
        ("front", "farfield"),
        tail,
    )


def solid_cases() -> Iterator[Case]:
    far, ends = ("farfield",), ("root", "tip")
    disc = o_grid(112, 16, 0.04, 20.0)
    yield Case(
        "extruded circle, 3 over 1", extruded(disc, 3, 1.0), ("body",), far, upright(ROUND), ends
    )
    yield Case(
        "extruded circle, 5 over 4",
        extruded(disc, 5, 4.0),
        ("body",),
        far,
        upright({n: ROUND[n] for n in ("lobes 3", "lobes 6", "ellipse", "dent")}),
        ends,
    )
    changes = {
        name: SECTION[name] for name in ("camber", "thickness", "bump", "waves", "flap", "pitch")
    } | SPAN
    yield Case("wing", cases.wing(points=700, stations=7), ("wing",), far, changes, ends)
    small = {name: SECTION[name] for name in ("camber", "thickness", "bump", "flap")}
    section = cases.naca4("0012", points=700, first_cell=1e-3, sharp=True)
    yield Case("extruded section, sharp", extruded(section, 5, 1.0), ("airfoil",), far, small, ends)
    o_section = faults.sharp_o_grid(around=64, layers=16, first_cell=1e-4)
    tapered = {
        name: motion for name, motion in small.items() if name != "bump"
    }  # it would tear the tip's shorter chord
    yield Case(
        "tapered section, O-grid",
        extruded(o_section, 6, 2.0, lambda eta: 1 - 0.5 * eta),
        ("airfoil",),
        far,
        tapered | SPAN,
        ends,
    )
    for kind, motions in (("hexahedron", floor((0, 1))), ("tetra", floor((0, 1)))):
        mesh = cases.bricks(kind, cells=6, first_cell=0.08)
        p = np.asarray(mesh.points)
        bottom = np.flatnonzero(p[:, 2] < 1e-9)
        others = np.flatnonzero(((p < 1e-9) | (p > 1 - 1e-9)).any(axis=1) & (p[:, 2] > 1e-9))
        yield Case(
            f"box, {kind}",
            jm.Mesh(p, mesh.cells, {"floor": bottom, "sides": others}),
            ("floor",),
            ("sides",),
            {n: m for n, m in motions.items() if n in ("hump", "ripple", "raise", "tilt")},
        )
    ball = shells(8, 10, 0.08, 12.0)
    out = lambda f: linear(lambda x: f(x / np.linalg.norm(x, axis=1)[:, None])[:, None] * x)  # noqa: E731
    yield Case(
        "sphere",
        ball,
        ("body",),
        far,
        {
            "shift": ROUND["shift"],
            "stretch": linear(lambda x: 0.3 * x * np.array([1.0, 0, 0])),
            "lobes": out(
                lambda n: 0.2 * np.cos(4 * np.arctan2(n[:, 1], n[:, 0])) * (1 - n[:, 2] ** 2)
            ),
            "dent": out(lambda n: -0.2 * np.exp(-((1 - n[:, 0]) / 0.15))),
            "growth": out(lambda n: np.full(len(n), 0.3)),
        },
    )
    plate = boxed(
        [
            axis(-2, 3, (0.0, 1.0), 0.125),
            axis(0, 3, (0.0, 1.5), 0.25),
            axis(-2, 2, (-0.05, 0.05), 0.05),
        ],
        [0, 0, -0.05],
        [1, 1.5, 0.05],
    )
    yield Case(
        "plate wing on a held wall",
        plate,
        ("body",),
        ("sides",),
        {
            "bend": linear(lambda x: along(-1, 0.3 * (x[:, 1] / 1.5) ** 2, 3)),
            "twist": lambda x, a: turn(x, 0.4 * a * x[:, 1] / 1.5, (0.5, 0.0)),
            "camber": linear(lambda x: along(-1, 0.4 * x[:, 0] * (1 - x[:, 0]) * x[:, 1] / 1.5, 3)),
            "thickness": linear(lambda x: along(-1, x[:, 2] * x[:, 1] / 1.5, 3)),
            "sweep": linear(lambda x: along(0, 0.3 * x[:, 1] / 1.5, 3)),
        },
    )
    rod = boxed(
        [
            axis(-1, 1, (-0.15, 0.15), 0.1),
            axis(-1, 1, (-0.15, 0.15), 0.1),
            axis(0, 2, (0.0, 1.0), 0.125),
        ],
        [-0.15, -0.15, 0],
        [0.15, 0.15, 1.0],
    )
    yield Case(
        "rod on a held floor",
        rod,
        ("body",),
        ("sides",),
        {
            "bend": linear(lambda x: along(0, 0.3 * x[:, 2] ** 2, 3)),
            "swell": linear(lambda x: 0.5 * x * np.array([1.0, 1, 0]) * smooth(x[:, 2:])),
            "grow": linear(lambda x: along(2, 0.3 * x[:, 2], 3)),
            "wring": lambda x, a: turn(x, 0.8 * a * x[:, 2], (0.0, 0.0), (0, 1)),
        },
    )
    two = boxed([axis(-3, 3, (-0.5, 0.5), 0.25)] * 3, [-0.5] * 3, [0.5] * 3)
    yield Case(
        "cube",
        two,
        ("body",),
        ("sides",),
        {
            "shift": ROUND["shift"],
            "turn": lambda x, a: turn(x, 0.5 * a, (0.0, 0.0)),
            "bulge": linear(
                lambda x: along(
                    2, 0.3 * (x[:, 2] > 0.49) * np.prod(np.cos(np.pi * x[:, :2]), axis=1), 3
                )
            ),
        },
    )


def graded(bodies: dict[str, np.ndarray], far: np.ndarray, *, growth: float = 0.35) -> jm.Mesh:
    """Triangles about closed curves (k, 2) inside a closed curve `far`, coarser with the distance from all of them.

    The cloud is the union of jittered grids, each twice as coarse as the last, in the band where its spacing is wanted.
    """
    curves, rng = [*bodies.values(), far], np.random.default_rng(7)
    walls = np.concatenate(curves)
    ends = np.concatenate([np.roll(curve, -1, axis=0) for curve in curves])
    size = np.linalg.norm(ends - walls, axis=1)
    fine = np.concatenate([walls + t * (ends - walls) for t in (0, 0.25, 0.5, 0.75)])
    edge, tree = np.tile(size, 4), KDTree(fine)
    solids = [Path(np.vstack([c, c[:1]])) for c in bodies.values()]
    outline = Path(np.vstack([far, far[:1]]))
    low, high, spacing, cloud = walls.min(axis=0), walls.max(axis=0), size.min(), [walls]
    while spacing < np.ptp(walls, axis=0).max():
        x, y = (np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True))
        if len(x) * len(y) > 4e6:  # the finest grids are wanted near walls alone
            near = walls[size < 4 * spacing]
            grid = (
                near[:, None]
                + spacing
                * np.stack(np.meshgrid(*[np.arange(-6, 7)] * 2), axis=-1).reshape(1, -1, 2)
            ).reshape(-1, 2)
            grid = np.unique(np.round((grid - low) / spacing), axis=0) * spacing + low
        else:
            grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        distance, nearest = tree.query(grid)
        wanted = edge[nearest] + growth * distance
        grid = grid[(wanted >= spacing) & (wanted < 2 * spacing) & (distance > 0.7 * spacing)]
        cloud.append(grid + rng.uniform(-0.2, 0.2, grid.shape) * spacing)
        spacing *= 2
    points = np.concatenate(cloud)
    inner = outline.contains_points(points) & ~np.any(
        [solid.contains_points(points) for solid in solids], axis=0
    )
    inner[: len(walls)] = True
    points = points[inner]
    cells = Delaunay(points).simplices
    middle = points[cells].mean(axis=1)
    cells = cells[
        outline.contains_points(middle)
        & ~np.any([solid.contains_points(middle) for solid in solids], axis=0)
    ]
    a, b, c = (points[cells[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    cells = np.where(area[:, None] < 0, cells[:, ::-1], cells)
    size = np.max([np.sum((p - q) ** 2, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    cells = cells[np.abs(area) > 1e-7 * size]
    used, cells = np.unique(cells, return_inverse=True)
    place, starts = np.full(len(points), -1), np.cumsum([0, *map(len, curves)])
    place[used] = np.arange(len(used))
    names = [*bodies, "farfield"]
    patches = {
        name: place[first:last]
        for name, first, last in zip(names, starts, starts[1:], strict=False)
    }
    return jm.Mesh(
        points[used], {"triangle": cells.reshape(-1, 3)}, {n: i[i >= 0] for n, i in patches.items()}
    )


def outline(corners: np.ndarray, spacing: float) -> np.ndarray:
    """A closed polygon, divided evenly between its corners."""
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    parts = [
        a
        + np.linspace(0, 1, max(2, round(np.linalg.norm(b - a) / spacing)), endpoint=False)[:, None]
        * (b - a)
        for a, b in sides
    ]
    return np.concatenate(parts)


def placed(curve: np.ndarray, chord: float, degrees: float, at: tuple[float, float]) -> np.ndarray:
    z = (curve @ np.array([1, 1j])) * chord * np.exp(-1j * np.deg2rad(degrees))
    return np.stack([z.real, z.imag], axis=1) + np.array(at)


def deck(side: int = 14, first: float = 0.006, layers: int = 36, growth: float = 1.17) -> jm.Mesh:
    """An O-grid about a rectangle 5 : 1 with right corners, whose cells are finest at the wall."""
    wall = outline(np.array([[-2.5, -0.5], [2.5, -0.5], [2.5, 0.5], [-2.5, 0.5]]), 1 / side)
    along_wall = np.roll(wall, -1, axis=0) - np.roll(wall, 1, axis=0)
    out = (
        np.stack([along_wall[:, 1], -along_wall[:, 0]], axis=1)
        / np.linalg.norm(along_wall, axis=1)[:, None]
    )
    depth = np.concatenate([[0], np.cumsum(first * growth ** np.arange(layers))])
    far = depth[-1] * wall / np.linalg.norm(wall, axis=1)[:, None]
    share = (depth / depth[-1])[:, None, None]
    places = wall + depth[:, None, None] * (1 - np.sqrt(share)) * out + np.sqrt(share) * share * far
    ids = block_ids(len(depth), len(wall))
    closed = np.column_stack([ids, ids[:, 0]])[:, ::-1]
    return jm.Mesh(
        places.reshape(-1, 2), {"quad": quads(closed)}, {"body": ids[0], "farfield": ids[-1]}
    )


BLUNT = {
    "camber": linear(lambda x: along(-1, 0.4 * (6.25 - x[:, 0] ** 2) / 6.25, 2)),
    "nose": linear(
        lambda x: along(
            0,
            0.3 * np.where(x[:, 0] < 0, -1, 1) * (1 - 4 * x[:, 1] ** 2) * (np.abs(x[:, 0]) > 2.4),
            2,
        )
    ),
    "shear": linear(lambda x: along(0, 0.5 * x[:, 1], 2)),
    "waves": linear(lambda x: along(-1, 0.1 * np.sin(1.2 * np.pi * (x[:, 0] + 2.5)), 2)),
    "thickness": linear(lambda x: along(-1, 0.3 * x[:, 1], 2)),
    "pitch": lambda x, amount: turn(x, 0.3 * amount, (0.0, 0.0)),
}


def body_cases() -> Iterator[Case]:
    """Blunt bodies, several bodies with narrow gaps, and bodies whose inside moves."""
    far = ("farfield",)
    yield Case("deck, O-grid", deck(), ("body",), far, BLUNT)
    box = outline(np.array([[-2.5, -0.5], [2.5, -0.5], [2.5, 0.5], [-2.5, 0.5]]), 0.08)
    yield Case(
        "deck, triangles",
        graded({"body": box}, circle(40, (0.0, 0.0), 20.0)),
        ("body",),
        far,
        BLUNT,
    )
    square = {"a": box, "b": box * 0.4 + np.array([3.7, 0.1])}
    mesh = graded(square, circle(40, (0.0, 0.0), 20.0))
    motions = {
        f"{name} of one": one_of(square, "a", motion, mesh) for name, motion in BLUNT.items()
    }
    yield Case("two decks", mesh, tuple(square), far, motions)
    for gap, fine in ((0.05, 1), (0.02, 2), (0.01, 3)):
        main, flap = (
            profile(70 * fine, 0.14),
            placed(profile(50 * fine, 0.12), 0.3, 20.0, (0.97, -0.02 - gap)),
        )
        slat = placed(profile(45 * fine, 0.1), 0.2, 25.0, (-0.17, -0.03 - gap))
        three = {"slat": slat, "main": main, "flap": flap}
        mesh = graded(three, circle(40, (0.5, 0.0), 12.0))
        motions = {
            "flap turned": one_of(three, "flap", lambda x, a: turn(x, 0.2 * a, (-0.1, 0.05)), mesh),
            "flap opened": one_of(
                three, "flap", linear(lambda x: along(-1, np.full(len(x), -0.02), 2)), mesh
            ),
            "flap closed": one_of(
                three,
                "flap",
                linear(lambda x, gap=gap: along(-1, np.full(len(x), 0.4 * gap), 2)),
                mesh,
            ),
            "slat turned": one_of(three, "slat", lambda x, a: turn(x, -0.2 * a, (0.0, 0.0)), mesh),
            "main cambered": one_of(
                three, "main", lambda x, a: along(-1, 0.2 * a * (0.25 - x[:, 0] ** 2), 2), mesh
            ),
        }
        yield Case(f"three elements, gap {gap}", mesh, tuple(three), far, motions)
    long = faults.sharp_o_grid(around=64, layers=24, first_cell=1e-3)
    yield Case("O-grid, sharp, long edges", long, ("airfoil",), far, SECTION)
    lobes = {name: ROUND[name] for name in ("lobes 3", "lobes 6", "ellipse", "dent", "shift")}
    channel = outline(np.array([[-3.0, -2.0], [8.0, -2.0], [8.0, 2.0], [-3.0, 2.0]]), 0.4)
    yield Case(
        "cylinder in a channel",
        graded({"body": circle(64, (0.0, 0.0), 1.0)}, channel),
        ("body",),
        far,
        lobes,
    )
    yield from solid_bodies()


def solid_bodies() -> Iterator[Case]:
    """A rod whose inside moves too, a vessel that narrows, a row of blades."""
    radius = np.concatenate([np.linspace(0.1, 0.5, 5), np.linspace(0.56, 1.0, 8)])
    angle, z = 2 * np.pi * np.arange(28) / 28, np.linspace(0, 6, 11)
    r, a, h = np.meshgrid(radius, angle, z, indexing="ij")
    ids = block_ids(len(radius), len(angle), len(z))
    closed = np.concatenate([ids, ids[:, :1]], axis=1)
    points = np.stack([r * np.cos(a), r * np.sin(a), h], axis=-1).reshape(-1, 3)
    patches = {"rod": ids[:5], "sleeve": ids[-1], "low": ids[..., 0], "high": ids[..., -1]}
    rod = jm.Mesh(
        points,
        {"hexahedron": hexahedra(closed)},
        {name: np.unique(i) for name, i in patches.items()},
    )
    wave = lambda x: np.sin(np.pi * x[:, 2] / 6) ** 2  # noqa: E731
    moved = {
        "shift": linear(lambda x: along(0, np.full(len(x), 0.3), 3)),
        "lean": linear(lambda x: along(0, 0.3 * wave(x), 3)),
        "swell": linear(lambda x: 0.5 * x * np.array([1.0, 1, 0]) * wave(x)[:, None]),
    }
    yield Case("rod, inside moves", rod, ("rod",), ("sleeve",), moved, ("low", "high"))
    t = np.linspace(-1, 1, 9)
    u, v, z = np.meshgrid(t, t, np.linspace(0, 8, 17), indexing="ij")
    disc = np.stack(
        [u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)], axis=-1
    )  # a square mapped to a disc
    size = np.linalg.norm(disc, axis=-1, keepdims=True)
    disc = disc * np.where(size > 0, (1 - (1 - size) ** 1.5) / np.maximum(size, 1e-9), 1.5)
    swell = 1 + 0.5 * np.exp(-((z - 4) ** 2))
    points = np.concatenate([disc * swell[..., None], z[..., None]], axis=-1).reshape(-1, 3)
    ids = block_ids(9, 9, 17)
    rim = np.unique(
        np.concatenate([ids[0].ravel(), ids[-1].ravel(), ids[:, 0].ravel(), ids[:, -1].ravel()])
    )
    ends = np.union1d(ids[..., 0], ids[..., -1])
    vessel = jm.Mesh(
        points, {"hexahedron": hexahedra(ids)}, {"wall": np.setdiff1d(rim, ends), "ends": ends}
    )
    bulge = lambda x: np.exp(-((x[:, 2] - 4) ** 2))[:, None]  # noqa: E731
    radial = np.array([1.0, 1, 0])
    changes = {
        "narrowed": linear(lambda x: -0.3 * x * radial * bulge(x)),
        "widened": linear(lambda x: 0.3 * x * radial * bulge(x)),
        "bent": linear(lambda x: along(0, 0.5 * np.sin(np.pi * x[:, 2] / 8) ** 2, 3)),
        "dent": linear(
            lambda x: -0.3 * x * radial * bulge(x) * (x[:, :1] > 0) * np.clip(x[:, :1], 0, None)
        ),
    }
    yield Case("vessel", vessel, ("wall",), ("ends",), changes)
    blade = extruded(faults.cascade(around=56, layers=12, first_cell=5e-3), 6, 1.0)
    sides = ("inlet", "outlet", "lower", "upper")
    stagger = upright({name: SECTION[name] for name in ("camber", "thickness", "pitch")})
    stagger["restagger"] = lambda x, a: turn(x, 0.3 * a * (0.3 + x[:, 1]), (0.5, 0.0))
    yield Case("blade row", blade, ("blade",), sides, stagger, ("root", "tip"))


def all_cases() -> Iterator[Case]:
    yield from flat_cases()
    yield from body_cases()
    yield from solid_cases()
