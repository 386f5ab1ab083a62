"""Files appear whole or not at all, whatever links, modes and threads are about."""

import errno
import os
import stat
import threading

import pytest

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.package.files import complete, output_path

posix = pytest.mark.skipif(os.name != "posix", reason="links and modes of POSIX")


def small():
    return jm.Mesh([[0.0, 0], [1, 0], [0, 1]], {"triangle": [[0, 1, 2]]}, {"edge": [0, 1]})


def names(folder):
    return sorted(path.name for path in folder.rglob("*"))


def test_a_failure_leaves_what_was_there(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(ZeroDivisionError), complete(tmp_path / "a.txt") as partial:
        partial.write_text("half" * (1 // 0))
    assert names(tmp_path) == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


def test_a_folder_appears_whole(tmp_path):
    with pytest.raises(ZeroDivisionError), complete(tmp_path / "case", folder=True) as partial:
        (partial / "points").write_text("half" * (1 // 0))
    assert names(tmp_path) == []
    with complete(tmp_path / "case", folder=True) as partial:
        (partial / "points").write_text("whole")
    assert (tmp_path / "case" / "points").read_text() == "whole"


@posix
def test_an_output_that_is_a_link_keeps_being_one(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "a.su2").write_text("old")
    (tmp_path / "link.su2").symlink_to(tmp_path / "real" / "a.su2")
    io.write(tmp_path / "link.su2", small())
    assert (tmp_path / "link.su2").is_symlink()
    assert len(io.read(tmp_path / "real" / "a.su2").points) == 3
    assert names(tmp_path / "real") == ["a.su2"]


@posix
def test_a_hard_link_to_the_old_file_keeps_its_content(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    os.link(tmp_path / "a.txt", tmp_path / "b.txt")
    with complete(tmp_path / "a.txt") as partial:
        partial.write_text("new")
    assert (tmp_path / "b.txt").read_text() == "old"


@posix
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664])
def test_a_replaced_file_hands_on_its_mode(tmp_path, mode):
    (tmp_path / "a.txt").write_text("old")
    (tmp_path / "a.txt").chmod(mode)
    with complete(tmp_path / "a.txt") as partial:
        assert stat.S_IMODE(partial.stat().st_mode) == mode  # while it is written too
        partial.write_text("new")
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == mode


def test_a_new_file_has_the_usual_mode(tmp_path):
    (tmp_path / "usual").write_text("")
    with complete(tmp_path / "a.txt"):
        pass
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "usual").stat().st_mode


@posix
def test_a_planted_link_is_not_followed(tmp_path, monkeypatch):
    """The name cannot be known; if it were, the next one is taken."""
    tokens = iter(["00000000", "11111111"])
    monkeypatch.setattr("secrets.token_hex", lambda size: next(tokens))
    with complete(tmp_path / "a.txt") as partial:
        planted = partial.with_name(partial.name.replace("11111111", "00000000"))
    tokens = iter(["00000000", "11111111"])
    (tmp_path / "victim").write_text("precious")
    planted.symlink_to(tmp_path / "victim")
    with complete(tmp_path / "a.txt") as partial:
        partial.write_text("new")
    assert (tmp_path / "victim").read_text() == "precious"
    assert (tmp_path / "a.txt").read_text() == "new"


def test_threads_that_write_one_file_do_not_meet(tmp_path):
    errors, start = [], threading.Barrier(4)

    def work(number):
        try:
            start.wait()
            for _ in range(20):
                with complete(tmp_path / "a.txt") as partial:
                    partial.write_text(str(number) * 1000)
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert names(tmp_path) == ["a.txt"]
    assert len(set((tmp_path / "a.txt").read_text())) == 1


@posix
@pytest.mark.parametrize("name", ["a b.su2", "Flügel ñ.su2", "-a.su2", ".hidden.su2"])
def test_names_with_blanks_and_letters_of_all_kinds(tmp_path, name):
    io.write(tmp_path / name, small())
    assert len(io.read(tmp_path / name).points) == 3
    assert names(tmp_path) == [name]


def test_a_name_is_a_path_with_one_of_the_endings(tmp_path):
    assert output_path(str(tmp_path / "a.PNG"), ".png", ".html") == tmp_path / "a.PNG"
    with pytest.raises(ValueError, match=r"a\.gif: the name should end in \.png or \.html\."):
        output_path(tmp_path / "a.gif", ".png", ".html")


def test_a_name_that_ends_as_a_folder_is_no_file(tmp_path):
    with pytest.raises(ValueError, match=r"a\.su2/: ends as a folder does, but a file is written"):
        io.write(f"{tmp_path}/a.su2/", small())
    assert not list(tmp_path.iterdir())


@posix
def test_an_error_of_the_system_names_the_output(tmp_path):
    """Not the temporary file, and not nothing; an error about another file keeps its name."""
    target = tmp_path / "a.txt"
    with pytest.raises(OSError, match=rf"No space left.*'{target}'$") as caught, complete(target):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert caught.value.errno == errno.ENOSPC
    with pytest.raises(NotADirectoryError, match=rf"'{target}'$"), complete(target) as partial:
        (partial / "below").write_text("")
    with pytest.raises(FileNotFoundError, match=r"missing'$"), complete(target):
        (tmp_path / "missing").read_text()
    with (
        pytest.raises(OSError, match=rf"{target}: not written \(9 requested and 3 written\)"),
        complete(target),
    ):
        raise OSError("9 requested and 3 written")
    assert names(tmp_path) == []


@posix
def test_devices_pipes_and_folders_are_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe.su2")
    (tmp_path / "link.su2").symlink_to("/dev/null")
    (tmp_path / "folder.su2").mkdir()
    (tmp_path / "loop.su2").symlink_to("loop.su2")
    for name in ("pipe", "link", "folder", "loop"):
        path = tmp_path / f"{name}.su2"
        message = rf"{name}\.su2: is a (folder|device or a pipe|symbolic link to itself)"
        with pytest.raises(ValueError, match=message):
            io.write(path, small())
        with pytest.raises(ValueError, match=message), complete(path):
            pass
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
    assert names(tmp_path) == ["folder.su2", "link.su2", "loop.su2", "pipe.su2"]


@posix
def test_the_longest_names_are_written(tmp_path):
    for name in ("x" * 251, "é" * 125 + "x"):
        with complete(tmp_path / f"{name}.su2") as partial:
            partial.write_text("new")
    assert len(names(tmp_path)) == 2


@posix
def test_a_pipe_is_not_read(tmp_path):
    """A reader would wait for someone who writes to it."""
    mesh = small()
    for reader, name in (
        (io.read, "a.su2"),
        (io.read, "a.cgns"),
        (jm.load, "a.npz"),
        (lambda path: io.read_displacement(path, mesh, [0]), "a.dat"),
        (lambda path: io.read_sensitivity(path, mesh), "b.npz"),
        (lambda path: io.read_surface(path, 2), "a.csv"),
        (lambda path: io.read_box(path, 2), "a.toml"),
    ):
        os.mkfifo(tmp_path / name)
        with pytest.raises(ValueError, match=f"{name}: is a device or a pipe"):
            reader(tmp_path / name)


@pytest.mark.parametrize("call", [io.read, lambda path: io.write(path, small())])
def test_a_name_with_a_null_byte(call):
    with pytest.raises(ValueError, match=r"'a\\x00b.su2': a name of a file holds no null byte"):
        call("a\0b.su2")
