"""Writing files: whole or not at all, and an error that says why not."""

import json
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest

from calib.core.base import replacing
from calib.core.base.errors import InputError
from calib.core.base.files import check_file, check_folder, write_file, write_folder
from calib.core.base.own_files import MANIFEST
from tests.project import ROOT
from tests.signed_files import plain

RESULT = {"result.json": b"{}", "parameters.csv": b"parameter,value,unit\n"}


def tree(folder):
    """Every file below a folder with its bytes, without what says who wrote them (test_own_files.py)."""
    files = {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}
    return {
        str(path.relative_to(folder)): content and plain(content).removesuffix(b"\n")
        for path, content in files.items()
        if path.name != MANIFEST
    }


def refusal(function, *arguments):
    with pytest.raises(InputError) as caught:
        function(*arguments)
    assert caught.value.exit_code == 2
    message = str(caught.value)
    assert message.startswith(str(arguments[0]))
    assert message.endswith("; choose another place for the output")
    return message


def test_a_file_is_written_and_replaced_as_a_whole_and_a_symbolic_link_stays_one(tmp_path):
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "folder" / "real")
    for path, folder, name in ((tmp_path / "here" / "out.csv", "here", "out.csv"), (link, "folder", "real")):
        (tmp_path / folder).mkdir(exist_ok=True)
        write_file(path, "one é\n")
        assert tree(tmp_path / folder) == {name: "one é".encode()}
        write_file(path, b"two")
        assert tree(tmp_path / folder) == {name: b"two"}
    assert link.is_symlink()


def test_a_new_file_has_ordinary_permissions_and_an_old_one_keeps_its_own(tmp_path):
    old = os.umask(0o027)
    try:
        write_file(tmp_path / "new", "")
    finally:
        os.umask(old)
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o640
    (tmp_path / "new").chmod(0o600)
    write_file(tmp_path / "new", "again")
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o600


def test_files_and_folders_are_refused_where_even_root_cannot_write_them(tmp_path):
    (tmp_path / "file").write_text("a file")
    files, folders = ((check_file,), (write_file, "text")), ((check_folder,), (write_folder, RESULT))
    for place, reason, functions in (
        ("file/below", "not a", files + folders),
        ("/proc/nothing_here", "no such file", files + folders),
        ("/sys/nothing_here", "", files + folders),  # read-only file system, or permission denied
        ("x" * 300, "file name too long", files + folders),
        ("no/out.csv", "no such file", files),
        (".", "is a folder", files),
        ("file", "is a file, not a folder", folders),
    ):
        for function, *arguments in functions:
            before = tree(tmp_path)
            assert reason in refusal(function, tmp_path / place, *arguments)
            assert tree(tmp_path) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_device_is_written_to_and_never_replaced(monkeypatch):
    monkeypatch.setattr(Path, "replace", lambda *_: pytest.fail("a device of this machine would be replaced"))
    for path in ("/dev/null", "/dev/stderr"):
        check_file(path)
    write_file("/dev/null", "nothing")
    assert Path("/dev/null").is_char_device()
    assert "no space left on device" in refusal(write_file, Path("/dev/full"), "text")
    assert Path("/dev/full").is_char_device()


def test_a_pipe_is_written_to(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    write_file(pipe, "through")
    reader.join(timeout=10)
    assert got == [b"through"]
    assert pipe.is_fifo()


def test_checking_creates_nothing(tmp_path):
    check_file(tmp_path / "out.csv")
    check_folder(tmp_path / "a" / "b" / "out")
    assert tree(tmp_path) == {}


def test_a_folder_is_written_with_its_parents_and_replaced_and_other_files_in_it_stay(tmp_path):
    out = tmp_path / "a" / "out"
    write_folder(out, {"result.json": b"old", "calibrated.urdf": b"of an earlier result"})
    (out / "notes").mkdir()
    (out / "notes" / "mine.txt").write_text("keep")
    (out / "link").symlink_to("notes/mine.txt")
    inode = (out / "notes" / "mine.txt").stat().st_ino
    out.chmod(0o750)
    write_folder(out, RESULT, obsolete=("calibrated.urdf", "never there"))
    assert {name: (out / name).read_bytes() for name in RESULT} == RESULT
    assert not (out / "calibrated.urdf").exists()
    assert (out / "notes" / "mine.txt").read_text() == "keep"
    assert (out / "notes" / "mine.txt").stat().st_ino == inode  # moved, not copied
    assert (out / "link").is_symlink()
    assert out.stat().st_mode & 0o777 == 0o750
    assert os.listdir(tmp_path / "a") == ["out"]  # noqa: PTH208


def test_the_current_folder_and_its_parents_are_not_exchanged(tmp_path, monkeypatch):
    here = tmp_path / "project" / "here"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    for path in (Path(), here, tmp_path / "project", Path("..")):
        for function, arguments in ((check_folder, ()), (write_folder, (RESULT,))):
            with pytest.raises(InputError, match="holds the current folder"):
                function(path, *arguments)
    check_folder(Path("result"))


@pytest.mark.parametrize("failing", ["staging", "taking the place", "setting aside", "replacing", "interrupted"])
def test_a_folder_whose_writing_fails_is_left_as_it_was(tmp_path, monkeypatch, failing):
    out = tmp_path / "out"
    write_folder(out, {"result.json": b"old", "other": b"mine"})
    renames, moments = [], {"taking the place": 1, "setting aside": 2, "replacing": 3}
    rename, write_bytes = Path.rename, Path.write_bytes
    monkeypatch.setattr(replacing, "exchange", lambda item, other: False)

    def failing_rename(self, target):
        renames.append(self)
        if len(renames) == moments.get(failing):
            raise OSError(28, "No space left on device")
        return rename(self, target)

    def failing_write(self, data):
        if failing == "interrupted":
            raise KeyboardInterrupt
        if failing == "staging" and self.name == "parameters.csv":
            raise OSError(28, "No space left on device")
        return write_bytes(self, data)

    monkeypatch.setattr(Path, "rename", failing_rename)
    monkeypatch.setattr(Path, "write_bytes", failing_write)
    with pytest.raises(KeyboardInterrupt if failing == "interrupted" else InputError) as caught:
        write_folder(out, RESULT)
    assert failing == "interrupted" or "no space left on device" in str(caught.value)
    assert tree(tmp_path) == {"out": None, "out/result.json": b"old", "out/other": b"mine"}


def in_process(code, *arguments, **options):
    """Run Python code in a process of its own, from the project's folder."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)


@pytest.mark.quick(0)
@pytest.mark.amount(8, 1)
def test_writing_that_is_ended_before_any_of_its_lines_leaves_the_old_or_the_new(amount):
    """Killed, and interrupted, at one line in so many; with the exchange of names in one step and without."""
    command = [sys.executable, "-m", "tests.core.base.interrupted_writing", "--every", str(amount)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    counted = json.loads(done.stdout)
    assert len(counted) == 8
    for item in counted.values():
        assert min(item["old"], item["new"]) >= 3 / amount  # it was ended before and after the one step that counts


WRITERS = """
import sys
from pathlib import Path
from calib.core.base import replacing
from calib.core.base.files import write_file, write_folder
out, word, exchange = Path(sys.argv[1]), sys.argv[2].encode(), sys.argv[3] == "True"
if not exchange:
    replacing.exchange = lambda one, other: False
for _ in range(100):
    write_folder(out, {name: word * 2000 for name in ("result.json", "parameters.csv")})
    write_file(out.parent / "table.csv", word * 2000)
"""


@pytest.mark.quick(0)
@pytest.mark.parametrize("exchange", [True, False])
def test_two_writers_at_once_end_with_the_result_of_one_and_lose_nothing(tmp_path, exchange):
    write_folder(tmp_path / "out", {"mine.txt": b"keep"})
    writers = [in_process(WRITERS, tmp_path / "out", word, exchange) for word in ("a", "b")]
    assert [writer.communicate()[1] for writer in writers] == ["", ""]
    seen = tree(tmp_path)
    assert seen.pop("out/mine.txt") == b"keep"
    assert seen["out/result.json"] == seen["out/parameters.csv"]
    assert {seen["out/result.json"][:1], seen["table.csv"][:1]} <= {b"a", b"b"}
    assert sorted(seen) == ["out", "out/parameters.csv", "out/result.json", "table.csv"]


def test_what_a_killed_program_left_is_cleared_by_the_next_but_not_what_a_living_one_holds(tmp_path):
    """`.calib-old-*` holds a result that was being replaced where names cannot be exchanged: it is put back."""
    (tmp_path / ".calib-new-left" / "inner").mkdir(parents=True)
    (tmp_path / ".calib-new-left" / "inner").chmod(0o500)
    (tmp_path / ".calib-new-file").write_text("half")
    (tmp_path / ".calib-old-left" / "out").mkdir(parents=True)
    (tmp_path / ".calib-old-left" / "out" / "mine.txt").write_text("keep")
    with replacing.new_folder(tmp_path) as living:
        (living / "content").write_text("half")
        write_folder(tmp_path / "out", {"result.json": b"new"})
        assert (living / "content").exists()
    assert tree(tmp_path) == {"out": None, "out/result.json": b"new", "out/mine.txt": b"keep"}


LIMITED = """
import resource, signal, sys
from calib.core.base.errors import InputError
from calib.core.base.files import write_file, write_folder
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write beyond the limit is then an error, as on a full disk
for function, content in ((write_folder, {"a": b"new", "b": b"n" * 100_000}), (write_file, b"n" * 100_000)):
    try:
        function(sys.argv[1] + ("/out" if function is write_folder else "/table.csv"), content)
    except InputError as error:
        print(error)
"""


def test_a_disk_without_room_leaves_the_old_result_and_nothing_else(tmp_path):
    write_folder(tmp_path / "out", {"a": b"old", "b": b"old"})
    write_file(tmp_path / "table.csv", b"old")
    before = tree(tmp_path)
    said, trouble = in_process(LIMITED, tmp_path).communicate()
    assert trouble == ""
    assert said.count("cannot be written (file too large)") == 2
    assert tree(tmp_path) == before


READ_ONLY = """
import os, sys
from calib.core.base.errors import InputError
from calib.core.base.files import check_file, check_folder, write_file, write_folder
if os.getuid() == 0:
    os.setuid(65534)  # root may write anywhere
for function, content in ((check_folder, ()), (check_file, ()), (write_folder, ({"a": b"new"},)), (write_file, (b"",))):
    for name in ("out", "new"):
        try:
            function(f"{sys.argv[1]}/{name}", *content)
        except InputError as error:
            print(error)
"""


def test_a_folder_that_may_only_be_read_stays_as_it_is(tmp_path):
    place = tmp_path / "place"
    write_folder(place / "out", {"a": b"old"})
    for folder in (tmp_path, *tmp_path.parents):
        if Path(tempfile.gettempdir()) in folder.parents:
            folder.chmod(0o755)  # that somebody else gets there
    before = tree(tmp_path)
    place.chmod(0o555)
    try:
        said, trouble = in_process(READ_ONLY, place).communicate()
        assert trouble == ""
        assert said.count("cannot be written (permission denied); choose another place") == 6
        assert said.count("cannot be written (is a folder)") == 2
        assert tree(tmp_path) == before
    finally:
        place.chmod(0o755)
