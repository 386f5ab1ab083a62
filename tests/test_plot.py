"""Pictures, judged by what was drawn: numbers of polygons, their places and their colours."""

import itertools

import matplotlib

matplotlib.use("Agg")


import foam
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgba
from meshes import ball, bricks, circle, grid, mixed
from runs import runs
from scipy.spatial import ConvexHull

import jaxmorph as jm
from jaxmorph import cases, io, plot
from jaxmorph.plot._space import outside

pytestmark = pytest.mark.usefixtures("closed_figures")


@pytest.fixture(scope="module")
def airfoil():
    return cases.naca0015(points=600)


def polygon(count):
    return np.stack([np.arange(count), np.roll(np.arange(count), -1)], axis=1)


def outlines(collection):
    return [path.vertices for path in collection.get_paths()]


def test_mesh_draws_each_cell_in_its_colour():
    mesh = mixed()
    axis = plot.mesh(mesh, values=[4.0, 1.0, 2.0], limits=(0, 4))
    faces, _, _ = axis.collections
    np.testing.assert_array_equal(faces.get_array(), [4, 1, 2])
    assert faces.get_clim() == (0, 4)
    assert len(outlines(faces)) == 3
    np.testing.assert_array_equal(outlines(faces)[0][:4], mesh.points[[0, 1, 2, 3]])
    np.testing.assert_array_equal(outlines(faces)[1][:3], mesh.points[[1, 4, 5]])
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("x", "y")


def test_a_value_that_all_cells_have_is_the_light_end():
    faces = plot.mesh(mixed(), values=np.full(3, 0.25)).collections[0]
    assert faces.get_clim()[0] == 0.25
    assert faces.get_clim()[1] > 1


@pytest.mark.parametrize("size", runs([0.2], nightly=[1e-3, 40.0]))
def test_numbers_and_names_are_within_the_figure(airfoil, size):
    """As first drawn, for windows whose numbers have many digits."""
    window = ((1 - size, 1 + size), (-size, size))
    values = np.linspace(0.9871, 0.9913, len(airfoil.cell_ids))
    for ax in (
        plot.before_after(airfoil, airfoil.points, window=window),
        plot.mesh(airfoil, window=window),
    ):
        assert_inside(ax)
    assert_inside(plot.mesh(airfoil, values=values, label="V/V0", window=window))


def assert_inside(ax):
    ax.figure.canvas.draw()
    drawn, (width, height) = ax.figure.get_tightbbox(), ax.figure.get_size_inches()
    assert min(drawn.x0, drawn.y0) >= 0
    assert drawn.x1 <= width
    assert drawn.y1 <= height
    labels = [text.get_window_extent() for text in ax.get_xticklabels() if text.get_text()]
    shown = [box for box in labels if ax.bbox.x0 - 1 <= (box.x0 + box.x1) / 2 <= ax.bbox.x1 + 1]
    assert all(left.x1 < right.x0 for left, right in itertools.pairwise(shown))


def test_walls_are_drawn_stronger_than_the_lines_between_cells():
    """Each edge is a line; those with a cell on one side alone are walls."""
    mesh = mixed()
    _, lines, walls = plot.mesh(mesh, values=np.ones(3)).collections
    outer = jm.boundary_faces(mesh)["line"]
    assert len(walls.get_segments()) == len(outer)
    found, expected = (
        {frozenset(map(tuple, edge)) for edge in each}
        for each in (walls.get_segments(), mesh.points[outer])
    )
    assert found == expected
    corners = sum(ids.size for ids in mesh.cells.values())
    assert len(lines.get_segments()) == (corners + len(outer)) / 2
    assert min(walls.get_linewidths()) > 2 * max(lines.get_linewidths())


def test_colours_are_not_paled_by_a_few_cells_and_lines_do_not_hide_them():
    """A value of 84 on a thousandth of the area leaves the colours to the others, and the bar has an arrow for it."""
    x = np.append(np.linspace(0, 1, 40), 1.0005)
    mesh = grid(x, [0.0, 1.0])
    values = np.append(np.linspace(0.1, 1, 39), 84.0)
    axis = plot.mesh(mesh, values=values)
    faces, lines, _ = axis.collections
    assert faces.get_clim() == (0.1, 1)
    assert [bar.properties().get("ylim") for bar in axis.child_axes]
    assert faces.colorbar.extend == "max"
    shown = {tuple(np.round(edge[:, 0], 6)) for edge in lines.get_segments()}
    assert (1.0005, 1.0005) not in shown  # the narrow cell has its colour and no line
    assert (0.0, 0.0) in shown
    assert (
        plot.mesh(mesh, values=values, limits=(0, 84)).collections[0].colorbar.extend == "neither"
    )


def test_new_figures_have_the_shape_of_their_content():
    for width, height in ((4.0, 1.0), (1.0, 1.0), (1.0, 3.0)):
        axis = plot.mesh(mixed(), window=((0.0, width), (0.0, height)))
        axis.figure.canvas.draw()
        inches = axis.get_window_extent().size / axis.figure.dpi
        np.testing.assert_allclose(inches[1] / inches[0], height / width, rtol=1e-6)
        assert (
            inches > 0.75 * np.array(axis.figure.get_size_inches()) - 0.6
        ).all()  # the rest is labels


def test_mesh_at_other_points_in_a_window_of_a_given_axis():
    mesh, given = mixed(), plt.subplots()[1]
    moved, window = mesh.points + np.array([10, 0]), ((10.1, 10.9), (0.2, 0.5))
    axis = plot.mesh(mesh, moved, values=[4, 1, 2], window=window, ax=given)
    assert axis is given
    assert axis.get_xlim() == (10.1, 10.9)
    np.testing.assert_array_equal(axis.collections[0].get_array(), [4])


LAYERS = grid(np.linspace(0, 4, 9), np.append(0, 1e-3 * 2.0 ** np.arange(12)))
"""Layers of quads, of which the first are 1e-3 high."""


def layer_lines(**values):
    lines = plot.mesh(LAYERS, window=plot.whole(LAYERS.points), **values).collections[-2]
    ends = np.array(lines.get_segments())
    return np.ptp(ends[:, :, 0], axis=1) > 0, ends[:, :, 1].max(axis=1), lines


def test_lines_are_thin_where_they_are_close():
    """Lines along thin layers; those across them are as far apart as elsewhere."""
    along, height, lines = layer_lines()
    widths = np.asarray(lines.get_linewidths())
    assert widths[along & (height < 2e-3)].max() < 0.1
    assert widths.max() <= 0.6
    np.testing.assert_allclose(widths[~along], widths.max())


def test_over_colours_whole_lines_fade():
    """A line along the layers has one ink from end to end, less the closer it is; lines across reach the wall."""
    along, height, lines = layer_lines(values=np.zeros(len(LAYERS.cell_ids)))
    ink = np.asarray(lines.get_colors())[:, 3]
    heights = np.unique(height[along])
    of_line = [np.unique(ink[along & (height == y)]) for y in heights]
    assert all(len(own) == 1 for own in of_line)
    faded = np.concatenate(of_line)
    assert (np.diff(faded[heights > heights[0]][:-1]) >= 0).all()
    assert faded.max() == 1
    assert 0 < faded.min() < 0.6
    assert len(heights) < 13  # the closest ones are left out
    assert (np.unique(height[~along]).size, ink[~along].min()) == (12, 1)


def test_bodies_are_filled_and_not_what_is_outside_of_a_channel(airfoil):
    """Also where a cut behind the body has two nodes at each place."""
    channel = grid(np.linspace(0, 3, 7), [0.0, 0.4, 1.0])
    channel = channel.moved(channel.points + 0.3 * np.sin(channel.points[:, [1, 0]]))
    axis = plot.mesh(channel, values=np.zeros(12))
    (outer,) = axis.patches
    assert len(outer.get_xy()) == 17
    assert to_rgba(axis.get_facecolor()) == to_rgba("white")
    rings = [patch.get_xy() for patch in plot.mesh(airfoil, values=np.zeros(588)).patches]
    wall = airfoil.points[airfoil.patch("airfoil")]
    assert len(rings) == 2
    assert {tuple(x) for x in min(rings, key=len)} == {tuple(x) for x in wall}


def test_a_wall_s_distances_are_drawn_before_and_after(tmp_path, figures):
    x = circle(20)
    wall, target = (jm.Facets(places, polygon(len(places))) for places in (x, 1.1 * circle(200)))
    plot.distances(tmp_path / "flat.png", wall, target, 1.05 * x, label="from scan.stl")
    before, after = figures[0].axes[:2]
    assert before.get_title() == "distance from scan.stl\nbefore: up to 0.1"
    assert after.get_title() == "distance from scan.stl\nafter: up to 0.05"
    ends = [axis.collections[-1].get_clim() for axis in (before, after)]
    assert ends[0][1] > 1.5 * ends[1][1] > 0  # each in its own colours
    plot.distances(tmp_path / "on.png", wall, target, 1.1 * x)
    on = figures[1].axes[1]
    assert on.get_title().endswith("after: none")
    assert on.collections[-1].get_array() is None


@pytest.mark.slow
def test_a_wall_s_distances_in_3d_fill_the_picture(tmp_path):
    points, faces = ball(60)
    wall, target = jm.Facets(points, faces), jm.Facets(1.1 * points, faces)
    plot.distances(tmp_path / "ball.png", wall, target, np.asarray(target.points))
    picture = plt.imread(tmp_path / "ball.png")[:, :, :3]
    halves = np.array_split(picture, 2)
    coloured = [(np.ptp(half, axis=2) > 0.1).mean() for half in halves]
    assert coloured[0] > 0.1 > 0.02 > coloured[1]  # on the target there is nothing to colour
    drawn = [(half.min(axis=2) < 0.95).mean() for half in halves]
    assert min(drawn) > 0.2


@pytest.mark.slow
def test_the_camera_sees_what_is_drawn_and_no_other_points():
    """One patch of a mesh fills the picture as far as it would alone."""
    mesh = bricks(2)
    roof = np.flatnonzero(mesh.points[:, 2] == 1)
    faces = outside(jm.Mesh(mesh.points, mesh.cells, {"roof": roof}), None, None, ("roof",))
    assert (faces.n_points, faces.n_cells) == (9, 4)
    assert faces.bounds[4] == faces.bounds[5] == 1


def test_colours_turn_round_where_small_is_bad_and_a_label_brings_a_bar():
    axis = plot.mesh(mixed(), values=[0.0, 1.0, 0.5], limits=(1, 0), label="V/V0")
    faces = axis.collections[0]
    assert faces.get_clim() == (0, 1)
    light, dark = plt.get_cmap(plot.COLOURS)([0.0, 1.0])
    np.testing.assert_allclose(faces.to_rgba([1.0, 0.0]), [light, dark])
    (bar,) = axis.child_axes
    assert bar.get_ylabel() == "V/V0"


@pytest.mark.nightly
def test_pictures_show_the_bodies_and_some_room(airfoil):
    """Unless a window is given; a mesh without inner patches is shown whole."""
    wall = airfoil.points[airfoil.patch("airfoil")]
    plan = jm.prepare(airfoil.points, airfoil.patch("airfoil"), airfoil.patch("farfield"))
    lifted = airfoil.points + np.array([0, 0.5])
    for ax, top in (
        (plot.mesh(airfoil), wall[:, 1].max()),
        (plot.graph(plan), wall[:, 1].max()),
        (plot.before_after(airfoil, lifted), wall[:, 1].max() + 0.5),
    ):
        (left, right), (bottom, high) = ax.get_xlim(), ax.get_ylim()
        assert -1 < left < wall[:, 0].min()
        assert wall[:, 0].max() < right < 2
        assert -1 < bottom < wall[:, 1].min()
        assert top < high < top + 1
    ax = plot.mesh(mixed())
    assert (ax.get_xlim(), ax.get_ylim()) == plot.whole(mixed().points)


@pytest.mark.parametrize("bar", [False, True])
def test_values_bring_a_bar_unless_told_otherwise(bar):
    bars = plot.mesh(mixed(), values=[0.0, 1.0, 0.5], bar=bar).child_axes
    assert [each.get_ylabel() for each in bars] == ["values of the cells"] * bar
    assert len(plot.surface(bricks(), values=np.arange(27.0), bar=bar).scalar_bars) == bar


def test_a_bar_in_3d_stands_beside_the_cells():
    for width, label in ((1, "V/V0"), (3, None)):
        mesh = jm.Mesh(bricks().points * [width, 1, 1], bricks().cells, {})
        plotter = plot.cut(
            mesh, plane=jm.Plane((0, 1.0, 0), (0, 0.5, 0)), values=np.arange(27.0), label=label
        )
        filled = np.flatnonzero((plotter.screenshot(return_img=True).min(axis=2) < 250).any(axis=0))
        assert filled[0] > 0
        assert (np.diff(filled) > 20).any()  # columns of pixels left white between cells and bar


@pytest.mark.nightly
def test_colours_in_3d_are_those_of_the_bar():
    """One value everywhere gives one colour, whichever way a face looks."""
    plotter = plot.surface(bricks(), values=np.full(27, 0.5), limits=(0, 1), bar=False)
    for actor in plotter.actors.values():
        if hasattr(getattr(actor, "prop", None), "show_edges"):
            actor.prop.show_edges = False
    picture = plotter.screenshot(return_img=True)
    colours, counts = np.unique(picture.reshape(-1, 3), axis=0, return_counts=True)
    colour, background = colours[np.argsort(counts)[-2:]]
    if (colour == 255).all():
        colour, background = background, colour
    np.testing.assert_allclose(colour / 255, plt.get_cmap(plot.COLOURS)(0.5)[:3], atol=0.01)
    assert np.sort(counts)[-2:].sum() > 0.98 * counts.sum()


def test_before_and_after_in_two_colours(airfoil):
    """The body that was is filled: not the lines of two meshes over each other."""
    moved = airfoil.points * [1, 2]
    axis = plot.before_after(airfoil, moved, window=plot.whole(moved))
    before, after, was, now = axis.collections
    np.testing.assert_array_equal(outlines(before)[0][:4], airfoil.points[airfoil.cells["quad"][0]])
    wall = jm.boundary_faces(airfoil)["line"]
    for walls, points in ((was, airfoil.points), (now, moved)):
        found = np.sort(np.concatenate(walls.get_segments()), axis=0)
        np.testing.assert_allclose(found, np.sort(points[wall].reshape(-1, 2), axis=0))
    lines = np.concatenate(after.get_segments())
    np.testing.assert_allclose(lines[:, 1].max(), moved[:, 1].max())
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["undeformed", "deformed"]
    assert axis.get_ylim()[1] == moved[:, 1].max()


def test_graph_has_the_edges_of_a_triangulation():
    points = np.random.default_rng(3).uniform(size=(40, 2))
    hull = ConvexHull(points).vertices
    plan = jm.prepare(
        points, [k for k in range(30) if k not in hull], list(hull), method=jm.DelaunayGraph()
    )
    nodes = np.concatenate([plan.moving, plan.fixed])
    axis = plot.graph(plan, interior=True, window=plot.whole(plan.points))
    (edges,) = axis.collections
    assert len(edges.get_segments()) == 3 * len(nodes) - 3 - len(hull)  # Euler
    assert len(axis.lines[0].get_xdata()) == len(points) - len(nodes)
    u = np.full((plan.n_moving, 2), 1e-3)
    moving = plot.graph(plan, u).lines[0]
    names = [text.get_text() for text in axis.get_legend().get_texts()]
    assert names == ["moving nodes", "fixed nodes"]
    low, high = (
        points[np.asarray(plan.fixed)].min(axis=0),
        points[np.asarray(plan.fixed)].max(axis=0),
    )
    inner = points[np.asarray(plan.moving)]
    place = inner[((inner > low + 0.2) & (inner < high - 0.2)).all(axis=1)][0]
    near = plot.graph(plan, window=tuple((float(c) - 1e-3, float(c) + 1e-3) for c in place))
    assert [text.get_text() for text in near.get_legend().get_texts()] == ["moving nodes"]
    np.testing.assert_allclose(moving.get_xdata(), points[np.asarray(plan.moving), 0] + 1e-3)


@pytest.mark.nightly
def test_legends_hide_nothing_at_the_width_of_a_column(airfoil):
    """Each stands above its axes, within the figure, and the axes stay larger than the legend."""
    plan = jm.prepare(airfoil, "airfoil", "farfield", method=jm.RBF(reduction=jm.KDTree(4)))
    window = plot.whole(airfoil.points)
    for draw in (
        lambda ax: plot.before_after(airfoil, airfoil.points, ax=ax),
        lambda ax: plot.graph(plan, window=window, ax=ax),
        lambda ax: plot.sources(plan, ax=ax),
        lambda ax: plot.histogram({"undeformed": jm.quality(airfoil)}, ax=ax),
    ):
        ax = draw(plt.subplots(figsize=(3.5, 2.6), layout="constrained")[1])
        ax.figure.canvas.draw()
        legend, drawn = ax.get_legend().get_window_extent(), ax.get_window_extent()
        assert legend.y0 >= drawn.y1 - 1
        assert -3 <= legend.x0 < legend.x1 <= ax.figure.bbox.x1 + 3
        assert max(drawn.size / ax.figure.bbox.size) > 0.4


def test_histogram_counts_every_cell(airfoil):
    before = jm.quality(airfoil)
    after = jm.quality(airfoil, airfoil.points @ np.array([[1, 0.3], [0, 1]]))
    axis = plot.histogram({"before": before, "after": after}, measure="aspect_ratio")
    heights = [bar.get_height() for bar in axis.containers[0]]
    counts, _ = np.histogram(before.aspect_ratio, bins=len(heights), range=axis.dataLim.intervalx)
    np.testing.assert_array_equal(heights, counts)
    assert sum(heights) == len(before.volume)
    assert axis.get_xlabel() == "aspect ratio"
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["before", "after"]


def test_histogram_counts_cells_of_the_highest_dimension_alone():
    none = jnp.zeros(5)
    flags = dict.fromkeys(("is_inverted", "is_degenerate", "was_inverted", "is_folded"), none > 0)
    names = (
        "skewness",
        "aspect_ratio",
        "jacobian",
        "non_orthogonality",
        "volume_ratio",
        "jacobian_ratio",
    )
    volume, types = jnp.array([7, 8, 1, 2, jnp.inf]), (("line", 2), ("quad", 1), ("triangle", 2))
    rest = dict.fromkeys(names, none) | flags
    report = jm.QualityReport(volume=volume, centroid=jnp.zeros((5, 2)), types=types, **rest)
    axis = plot.histogram({"all": report}, measure="volume")
    assert sum(bar.get_height() for bar in axis.containers[0]) == 2
    assert axis.get_xlim()[1] < 3
    assert axis.get_ylim()[0] < 1  # a single cell is seen


def test_surface_takes_the_colours_of_its_cells():
    mesh = bricks()
    plotter = plot.surface(mesh, values=np.arange(27.0), limits=(0, 26))
    faces = plotter.meshes[0]
    assert faces.n_cells == 6 * 9
    cell = np.minimum(faces.cell_centers().points * 3, 2.5).astype(int) @ [9, 3, 1]
    np.testing.assert_array_equal(faces.cell_data["values"], cell)
    picture = plotter.screenshot(return_img=True)
    assert picture.shape[1] == 1200
    assert 450 <= picture.shape[0] <= 900
    assert picture.std() > 10
    assert (picture[[0, -1]] == 255).all()  # the body is inside
    assert (picture[:, [0, -1]] == 255).all()
    assert (picture.std(axis=2) > 10).any(axis=1).mean() > 0.7  # and fills the height


def test_the_bar_in_3d_has_round_numbers_and_its_whole_label():
    """VTK takes an ASCII bar for a border between columns of text."""
    plotter = plot.surface(
        bricks(), values=np.linspace(0.013, 0.871, 27), limits=(0.871, 0.013), label="|V/V0 - 1|"
    )
    (bar,) = plotter.scalar_bars.values()
    np.testing.assert_allclose(np.asarray(bar.GetCustomLabels()), [0.2, 0.4, 0.6, 0.8])
    assert bar.GetTitle().strip() == "\u2223V/V0 - 1\u2223"
    assert plotter.mapper.scalar_range == (0.013, 0.871)
    dark = np.array(plotter.mapper.lookup_table.map_value(0.013))[:3]
    np.testing.assert_allclose(dark, plt.get_cmap(plot.COLOURS)(255)[:3], atol=0.01)


def test_before_and_after_in_3d():
    """What stays where it was is drawn once, so that no two facets coincide."""
    mesh = bricks()
    moved = mesh.points * [1, 1, 2]
    plotter = plot.before_after_3d(mesh, moved)
    still, before, after = plotter.meshes
    assert (still.n_cells, before.n_cells, after.n_cells) == (9, 5 * 9, 5 * 9)
    np.testing.assert_allclose(np.array(still.bounds), [0, 1, 0, 1, 0, 0])
    np.testing.assert_allclose(np.array(before.bounds), [0, 1] * 3)
    np.testing.assert_allclose(np.array(after.bounds), [0, 1, 0, 1, 0, 2])
    names = [actor.input for name, actor in plotter.actors.items() if name.startswith("legend")]
    assert names == ["in place", "undeformed", "deformed"]


@pytest.mark.nightly
def test_without_a_patch_bodies_are_drawn_in_3d_and_not_what_is_round_them():
    mesh = cases.wing(points=600, first_cell=1e-3)
    moved = np.asarray(mesh.points) * [1, 1, 1.1]
    counts = [
        sum(part.n_cells for part in plot.surface(mesh, patch=patch).meshes)
        for patch in (None, "wing", ".*")
    ]
    assert counts[0] == counts[1] < counts[2] == sum(map(len, jm.boundary_faces(mesh).values()))
    wall = np.asarray(mesh.points)[mesh.patch("wing")]
    for part in plot.before_after_3d(mesh, moved).meshes:
        assert (np.abs(part.points) <= np.abs(wall).max(axis=0) * 1.1 + 1e-9).all()


def test_one_state_is_seen_through_the_other():
    """A body that grows hides what it was, and one that shrinks what became of it, unless both let light through."""
    mesh = bricks()
    for factor in (2, 0.5):
        plotter = plot.before_after_3d(mesh, 0.5 + factor * (mesh.points - 0.5))
        picture = plotter.screenshot(return_img=True).astype(int)
        height, _width = picture.shape[:2]
        drawn = np.flatnonzero((picture.min(axis=2) < 250).any(axis=0))
        middle = int(drawn[[0, -1]].mean())
        row = picture[int(0.45 * height), drawn[0] : drawn[-1]]
        inner, outer = row[middle - drawn[0]], row[len(row) // 8]
        assert np.abs(inner - outer).max() > 12


def sphere_half(side):
    """The half y > 0 or y < 0 of a box of bricks, whose side at y = 0 is in no patch: a body that is open there."""
    mesh = bricks()
    points = mesh.points * [1, side, 1]
    body = np.flatnonzero((mesh.points[:, [0, 2]] % 1 == 0).any(axis=1) | (mesh.points[:, 1] == 1))
    cells = {
        kind: ids if side > 0 else ids[:, [1, 0, 3, 2, 5, 4, 7, 6]]
        for kind, ids in mesh.cells.items()
    }
    return jm.Mesh(points, cells, {"body": body})


@pytest.mark.parametrize("side", [1, -1])
def test_the_camera_does_not_look_into_an_open_body(side):
    plotter = plot.surface(sphere_half(side), patch="body")
    assert plotter.meshes[0].n_cells == 5 * 9
    position, focus, _ = np.array(list(plotter.camera_position))
    assert (position - focus)[1] * side > 0  # the open side is that of smaller |y|
    assert (position - focus)[2] > 0


@pytest.mark.nightly
def test_pictures_in_3d_have_axes_and_a_scale_of_a_round_length():
    plotter = plot.surface(bricks())
    plotter.screenshot(return_img=True)
    (scale,) = [prop for prop in plotter.renderer.GetViewProps() if prop.IsA("vtkAxisActor2D")]
    width, height = plotter.window_size

    def length():
        plotter.render()
        share = (
            scale.GetPosition2Coordinate().GetValue()[0]
            - scale.GetPositionCoordinate().GetValue()[0]
        )
        return share * 2 * plotter.camera.parallel_scale * width / height

    for zoom in (1, 3.7):
        plotter.camera.parallel_scale *= zoom
        assert length() == pytest.approx(float(scale.GetTitle()))
    assert plotter.renderer.axes_actor is not None


def test_cut_shows_the_cells_that_the_plane_meets():
    mesh = bricks()
    plotter = plot.cut(mesh, values=np.arange(27.0), plane=jm.Plane((1.0, 0, 0), (0.5, 0, 0)))
    section = plotter.meshes[0]
    np.testing.assert_allclose(section.points[:, 0], 0.5)
    np.testing.assert_array_equal(np.unique(section.cell_data["values"]), np.arange(9, 18))
    np.testing.assert_allclose(section.area, 1)
    position, focus, _ = np.array(list(plotter.camera_position))
    np.testing.assert_allclose(np.abs(position - focus)[1:], 0, atol=1e-9)  # seen along the normal
    again = plot.surface(mesh, patch="floor", plotter=plotter)
    assert again is plotter


def test_a_cut_along_nodes_has_each_edge_once():
    """Round-off of nodes in the plane does not cut the cells on both its sides by turns."""
    box = bricks(4)
    points = box.points + np.random.default_rng(0).uniform(-1e-13, 1e-13, box.points.shape)
    plotter = plot.cut(box, points, plane=jm.Plane((0, 1.0, 0), (0, 0.5, 0)))
    section, lines, _ = plotter.meshes
    assert section.n_cells == 16
    assert lines.n_cells == 2 * 4 * 5


def test_a_cut_shows_whole_polyhedra(tmp_path):
    """A cube beside four small ones, cut across all: its section is one square, though its pieces are many."""
    mesh = io.read(foam.write_case(tmp_path / "a", *foam.split(), foam.PATCHES))
    assert len(mesh.cell_ids) > 5
    plotter = plot.cut(mesh, plane=jm.Plane((0, 0, 1.0), (0, 0, 0.25)))
    section, lines, walls = plotter.meshes
    np.testing.assert_allclose(section.area, 2)
    edges = lines.points[lines.lines.reshape(-1, 3)[:, 1:]]
    assert (
        not ((edges[..., :2] > 1e-6) & (edges[..., :2] < 1 - 1e-6)).all(axis=(1, 2)).any()
    )  # of the cube
    between = np.all(np.abs(edges[:, :, 0] - 1) < 1e-6, axis=1)  # the cube and the small ones
    length = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    np.testing.assert_allclose(
        length[~between].sum(), 6 + 1, rtol=1e-6
    )  # round both, and between the small ones
    assert length[between].sum() > 1 - 1e-6
    round_it = walls.points[walls.lines.reshape(-1, 3)[:, 1:]]
    np.testing.assert_allclose(
        np.linalg.norm(round_it[:, 1] - round_it[:, 0], axis=1).sum(), 6, rtol=1e-6
    )
    # faces of the cube, of five corners too, and of the small ones
    assert plot.surface(mesh).meshes[0].n_cells == 5 + 12


def test_a_cut_is_cropped_to_the_body_that_it_meets():
    """With room of 0.4 of its size; beside the body all is shown."""
    box = bricks(9)
    corners = box.cells["hexahedron"]
    inside = (np.abs(box.points[corners].mean(axis=1) - 0.5) < 0.1).all(axis=1)
    body = np.unique(corners[inside])
    mesh = jm.Mesh(box.points, {"hexahedron": corners[~inside]}, {"body": body})
    for place, area in ((0.5, (1.8**2 - 1) / 81), (0.8, 1)):
        plotter = plot.cut(mesh, plane=jm.Plane((0, 1.0, 0), (0, place, 0)))
        np.testing.assert_allclose(plotter.meshes[0].area, area, rtol=1e-6)


def test_values_follow_the_order_of_the_cells_for_mixed_types():
    points = np.array(
        [*[[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], [2, 0.5, 0.5]],
        float,
    )
    mesh = jm.Mesh(points, {"pyramid": [[1, 2, 6, 5, 8]], "hexahedron": [[0, 1, 2, 3, 4, 5, 6, 7]]})
    plotter = plot.surface(mesh, values=[7.0, 3.0])  # types stand in alphabetical order
    faces = plotter.meshes[0]
    np.testing.assert_array_equal(
        faces.cell_data["values"], np.where(faces.cell_centers().points[:, 0] > 1, 3, 7)
    )


def test_cells_outside_of_the_usual_window_are_drawn_too():
    """A reader moves the view; a window that was asked for is drawn alone."""
    mesh = cases.naca0015(points=2000)
    count = len(mesh.cells["quad"])
    assert len(plot.mesh(mesh, values=np.zeros(count)).collections[0].get_paths()) == count
    near = plot.mesh(mesh, values=np.zeros(count), window=((0.0, 1.0), (-0.2, 0.2)))
    assert len(near.collections[0].get_paths()) < count


ZERO = np.zeros(3)
REFUSED = [
    (lambda: plot.mesh(mixed(), values=np.zeros(6)), "3 cells"),
    (lambda: plot.mesh(bricks()), r"plot\.surface"),
    (lambda: plot.mesh(mixed(), label="skewness"), "no `values`"),
    (lambda: plot.mesh(mixed(), values=ZERO, limits=(1, 1)), "`limits`"),
    (lambda: plot.mesh(mixed(), values=ZERO, limits=(0, np.nan)), "`limits`"),
    (lambda: plot.mesh(mixed(), np.zeros((5, 2))), r"shape \(5, 2\)"),
    (lambda: plot.surface(mixed()), r"plot\.mesh"),
    (lambda: plot.surface(bricks(), patch="roof"), "no patch is called 'roof'"),
    (lambda: plot.surface(bricks(), label="skewness"), "no `values`"),
    (
        lambda: plot.surface(
            jm.Mesh(bricks().points, bricks().cells, {"corner": [0]}), patch="corner"
        ),
        "no face",
    ),
    (lambda: plot.before_after_3d(bricks(), np.zeros((3, 3))), r"shape \(3, 3\)"),
    (lambda: plot.cut(bricks(), plane=jm.Plane((1.0, 0, 0), (7.0, 0, 0))), "nothing to draw"),
    (lambda: plot.histogram({}, measure="skew"), "'skew'; there are skewness"),
    (lambda: plot.histogram({}), "empty"),
]


def never(points):
    raise AssertionError("drawn")


@pytest.mark.parametrize(("call", "said"), REFUSED)
def test_what_cannot_be_drawn_is_refused_before_anything_is_drawn(
    tmp_path, monkeypatch, call, said
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=said):
        call()
    assert not plt.get_fignums()
    assert not list(tmp_path.iterdir())
