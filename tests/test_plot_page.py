"""Pages: what was written is read again, and drawn by a browser."""

import base64
import io
import re
import shutil
import zlib

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pytest
from meshes import bricks
from PIL import Image
from runs import runs

import jaxmorph as jm
from jaxmorph import cases, plot

pytestmark = pytest.mark.usefixtures("closed_figures")


def raised(mesh, height=0.5):
    """The mesh with its upper nodes moved up."""
    return mesh.points + height * mesh.points[:, -1:] * np.eye(mesh.points.shape[1])[-1]


def test_cells_outside_of_the_usual_window_are_drawn_too():
    """A reader moves the view; a window that was asked for is drawn alone."""
    mesh = cases.naca0015(points=2000)
    count = len(mesh.cells["quad"])
    assert len(plot.mesh(mesh, values=np.zeros(count)).collections[0].get_paths()) == count
    near = plot.mesh(mesh, values=np.zeros(count), window=((0.0, 1.0), (-0.2, 0.2)))
    assert len(near.collections[0].get_paths()) < count


def scene(path):
    """The objects in a page, as k3d packs them."""
    msgpack = pytest.importorskip("msgpack")
    packed = re.search(r"var data = '([^']*)'", path.read_text())
    content = msgpack.unpackb(
        zlib.decompress(base64.b64decode(packed.group(1))), strict_map_key=False
    )
    return {each["name"]: each for each in content["objects"]}


def array(packed):
    return np.frombuffer(packed["data"], packed["dtype"]).reshape(packed["shape"])


def test_a_page_holds_the_surface_before_and_after(tmp_path):
    mesh = bricks(3)
    path = plot.page(tmp_path / "cube.html", mesh, raised(mesh), label="</script>")
    assert [each.name for each in tmp_path.iterdir()] == ["cube.html"]
    assert path.stat().st_size < 2.5e6
    objects = scene(path)
    surface, edges = objects["surface"], objects["edges"]
    before, after = (array(surface["vertices"][time]) for time in "01")
    assert len(before) == 4**3 - 2**3
    np.testing.assert_allclose(np.ptp(before, axis=0), [1, 1, 1], atol=1e-6)
    np.testing.assert_allclose(np.ptp(after, axis=0), [1, 1, 1.5], atol=1e-6)
    np.testing.assert_allclose(
        array(surface["attribute"]["1"]), np.linalg.norm(after - before, axis=1), atol=1e-6
    )
    corners = before[array(surface["indices"])]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert len(corners) == 2 * 6 * 9
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1).sum() / 2, 6, rtol=1e-6)
    ends = before[array(edges["indices"])]
    assert len(ends) == 2 * 6 * 9  # each of the quadrilaterals' four sides belongs to two
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 1 / 3, rtol=1e-5)
    assert "</script>" not in path.read_text().split('id = "deformation"')[1].split("setTime")[0]


def test_a_page_takes_the_colours_of_the_cells_of_a_patch(tmp_path):
    mesh = bricks(3)
    path = plot.page(
        tmp_path / "f.html",
        mesh,
        mesh.points,
        values=np.arange(27.0),
        limits=(0, 26),
        patch="floor",
    )
    surface = scene(path)["surface"]
    corners = array(surface["vertices"]["1"])[array(surface["indices"])]
    np.testing.assert_array_equal(corners[..., 2], 0)
    cell = ((corners.mean(axis=1)[:, :2] + 0.5) * 3).astype(int) @ [9, 3]
    np.testing.assert_array_equal(array(surface["triangles_attribute"]), cell)
    assert surface["color_range"] == [0, 26]


@pytest.fixture
def browser():
    """Chromium, drawing WebGL in software."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="no playwright: pip install playwright"
    )
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    options = [
        "--no-sandbox",
        "--disable-quic",
        "--enable-unsafe-swiftshader",
        "--use-angle=swiftshader",
    ]
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=program, args=options)
        yield opened
        opened.close()


def opened(browser, path, height=480):
    """A tab with a page that is drawn, what goes wrong there, and what it asks for."""
    tab, problems, requests = browser.new_page(viewport={"width": 640, "height": height}), [], []
    tab.on(
        "console",
        lambda message: (
            problems.append(message.text) if message.type in ("error", "warning") else None
        ),
    )
    tab.on("pageerror", lambda error: problems.append(str(error)))
    tab.on("dialog", lambda dialog: (problems.append(dialog.message), dialog.dismiss()))
    tab.on("request", lambda request: requests.append(request.url))
    tab.goto(path.as_uri())
    tab.wait_for_selector("#deformation", timeout=30_000)
    return tab, problems, requests


@pytest.mark.slow
def test_a_page_draws_in_a_browser_without_a_network(tmp_path, browser):
    mesh = bricks(4)
    path = plot.page(tmp_path / "cube.html", mesh, raised(mesh, 2), label="displacement, m")
    tab, problems, requests = opened(browser, path)

    def body():
        """Rows and columns of the picture, without slider and scale, in which something is drawn; and how many colours."""
        picture = np.asarray(Image.open(io.BytesIO(tab.screenshot())))
        middle = picture[90:, 120:560, :3].astype(int)
        drawn = (middle < 240).any(axis=2)
        return (
            drawn.any(axis=1).sum(),
            drawn.any(axis=0).sum(),
            len(np.unique(middle[drawn], axis=0)),
        )

    def until(seen):
        """The first body that is as `seen` says, or the last after 20 seconds."""
        for _ in range(40):
            tab.wait_for_timeout(500)
            if seen(*(last := body())):
                break
        return last

    tall, wide, colours = until(lambda tall, wide, colours: tall > 150)
    assert tall > 150
    assert wide > 100
    assert colours > 30
    tab.locator("#time").fill("0")  # undeformed
    low, _, few = until(lambda low, *_: low < 0.7 * tall)
    assert 50 < low < 0.7 * tall
    assert few > 10
    assert tab.title() == "cube"
    assert tab.locator("#label").inner_text() == "displacement, m"
    assert not problems
    assert [url for url in requests if not url.startswith("blob:")] == [path.as_uri()]


@pytest.mark.slow
def test_a_page_shows_both_ends_in_a_narrow_window(tmp_path, browser):
    """Also after the window has changed its shape."""
    cube = bricks(2)
    bar = jm.Mesh(cube.points * np.array([6, 1, 1]), cube.cells)
    path = plot.page(tmp_path / "bar.html", bar, bar.points + np.array([0, 0, 0.5]))
    tab, _, _ = opened(browser, path, height=360)
    tab.set_viewport_size({"width": 360, "height": 640})
    for _ in range(40):
        tab.wait_for_timeout(500)
        picture = np.asarray(Image.open(io.BytesIO(tab.screenshot())))[..., :3]
        ends = np.flatnonzero(
            (picture[200:480] < 240).any(axis=(0, 2))
        )  # without slider and directions
        if len(ends) and ends[0] > 0 and ends[-1] < 359:
            break
    assert ends[0] > 0
    assert ends[-1] < 359
    assert np.ptp(ends) > 220


HOSTILE = [
    "</script><script>alert(1)",
    'LABEL";alert(1);"',
    "TITLE \\\\",
    "a\u2028b ${alert(1)} `'\"",
]


@pytest.mark.parametrize("text", runs(slow=HOSTILE[:1], nightly=HOSTILE[1:]))
def test_names_on_a_page_are_data(tmp_path, browser, text):
    """Whatever a file or a label is called, it is shown and not run."""
    mesh = bricks(1)
    path = plot.page(tmp_path / f"{text.replace('/', ' ')}.html", mesh, raised(mesh, 2), label=text)
    tab, problems, _ = opened(browser, path)
    assert tab.locator("#label").text_content() == text
    assert tab.evaluate("document.title").split() == path.stem.split()
    assert not problems
