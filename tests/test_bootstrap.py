"""bootstrap.py decides right what to install, finds pip on an index, and says what is wrong in one line."""

import ast
import hashlib
import http.server
import os
import sys
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import bootstrap

ROOT = Path(__file__).resolve().parent.parent
SETTINGS = ("PIP_INDEX_URL", "PIP_CERT", "PIP_PROXY", "PIP_CONFIG_FILE")


@pytest.fixture(autouse=True)
def no_settings_of_this_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in SETTINGS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)


# The first lines, which a Python that is too old must understand


def test_a_python_that_is_too_old_can_read_the_file() -> None:
    ast.parse((ROOT / "bootstrap.py").read_text(), feature_version=(3, 7))


@pytest.mark.parametrize("version", [(3, 6), (3, 10)])
def test_a_python_that_is_too_old_is_told_so(version: tuple[int, int]) -> None:
    complaint = bootstrap.python_complaint(version, "linux")
    assert "Python >= 3.11" in complaint
    assert f"{version[0]}.{version[1]}" in complaint
    assert "\n" not in complaint


def test_windows_is_sent_to_wsl_and_the_rest_may_go_on() -> None:
    assert "WSL" in bootstrap.python_complaint((3, 12), "win32")
    assert bootstrap.python_complaint((3, 11), "linux") == bootstrap.python_complaint((3, 14), "darwin") == ""


def test_the_oldest_python_is_the_one_that_the_package_declares() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"]
    oldest = tuple(int(part) for part in declared.removeprefix(">=").split("."))
    assert bootstrap.python_complaint(oldest, "linux") == ""
    assert bootstrap.python_complaint((oldest[0], oldest[1] - 1), "linux") != ""


# What is installed, and when


class FakeVenv:
    """Stands where .venv would be made, and notes the commands; a command whose text holds `failing` fails."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.root = folder
        self.commands: list[str] = []
        self.failing = "nothing"
        self.has_pip = True
        (folder / "pyproject.toml").write_text("one")
        monkeypatch.setattr(bootstrap, "ROOT", folder)
        monkeypatch.setattr(bootstrap, "VENV", folder / ".venv")
        monkeypatch.setattr(bootstrap, "PYTHON", folder / ".venv" / "bin" / "python")
        monkeypatch.setattr(bootstrap, "STAMP", folder / ".venv" / ".bootstrap")
        monkeypatch.setattr(bootstrap, "run", self.run)
        monkeypatch.setattr(bootstrap, "works", lambda *arguments: self.has_pip or "pip" not in arguments)
        monkeypatch.setattr(bootstrap, "install_pip", lambda: self.commands.append("pip"))

    def run(self, what: str, *command: object) -> None:
        text = " ".join(str(part) for part in command)
        if self.failing in text:
            raise bootstrap.BootstrapError(what)
        if "venv" in command:
            (self.root / ".venv" / "bin").mkdir()
            (self.root / ".venv" / "bin" / "python").touch()
        self.commands.append("venv" if "venv" in command else text.rpartition(" ")[2])

    def prepare(self, with_tests: bool = False) -> list[str]:
        self.commands.clear()
        bootstrap.prepare(with_tests)
        return self.commands


@pytest.fixture
def venv(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeVenv:
    return FakeVenv(tmp_path, monkeypatch)


def test_the_first_time_makes_all_and_the_second_nothing(venv: FakeVenv) -> None:
    assert venv.prepare() == ["venv", "."]
    assert venv.prepare() == []


def test_the_tests_packages_come_when_a_test_tool_is_first_asked_for_and_stay(venv: FakeVenv) -> None:
    venv.prepare()
    assert venv.prepare(with_tests=True) == [".[test]"]
    assert venv.prepare(with_tests=True) == []
    assert venv.prepare() == []
    (venv.root / "pyproject.toml").write_text("two")
    assert venv.prepare() == [".[test]"]


def test_changed_requirements_are_installed_into_the_same_venv(venv: FakeVenv) -> None:
    venv.prepare()
    (venv.root / "pyproject.toml").write_text("two")
    assert venv.prepare() == ["."]


def test_an_interrupted_install_is_made_anew(venv: FakeVenv) -> None:
    venv.failing = "pip install"
    with pytest.raises(bootstrap.BootstrapError):
        venv.prepare()
    (leftover := venv.root / ".venv" / "half_a_package").touch()
    venv.failing = "nothing"
    assert venv.prepare() == ["venv", "."]
    assert not leftover.exists()


def test_a_venv_of_another_python_or_without_one_is_made_anew(venv: FakeVenv, monkeypatch: pytest.MonkeyPatch) -> None:
    venv.prepare()
    monkeypatch.setattr(sys, "base_prefix", "/another/python")
    assert venv.prepare() == ["venv", "."]
    bootstrap.PYTHON.unlink()
    assert venv.prepare() == ["venv", "."]


def test_a_venv_that_the_person_made_is_kept_and_filled(venv: FakeVenv) -> None:
    bootstrap.PYTHON.parent.mkdir(parents=True)
    bootstrap.PYTHON.touch()
    assert venv.prepare() == ["."]


def test_pip_is_brought_where_there_is_none(venv: FakeVenv) -> None:
    venv.has_pip = False
    assert venv.prepare() == ["venv", "pip", "."]


def test_pip_is_kept_from_installing_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIP_TARGET", "/elsewhere")
    monkeypatch.setenv("PIP_USER", "1")
    monkeypatch.setenv("PIP_INDEX_URL", "https://index.example/simple")
    environment = bootstrap.environment()
    assert "PIP_TARGET" not in environment
    assert environment["PIP_USER"] == "0"
    assert environment["PIP_INDEX_URL"] == "https://index.example/simple"


def test_help_is_shown_and_nothing_made(venv: FakeVenv) -> None:
    for arguments in ([], ["--help"]):
        with pytest.raises(SystemExit, match=r"bootstrap\.py fieldloc compare"):
            bootstrap.main(arguments)
    assert venv.commands == []


# pip from a package index


def test_the_link_to_pip_is_found_among_others() -> None:
    page = f"""
        <a href="pip-9.0-py3-none-any.whl#sha256=00">pip-9.0</a>
        <a data-requires-python="&gt;=3.9" href="../../files/{bootstrap.PIP_WHEEL}?a=1&amp;b=2#sha256=11">pip</a>
    """
    url = bootstrap.wheel_url(page, "https://index.example/simple/pip/")
    assert url == f"https://index.example/files/{bootstrap.PIP_WHEEL}?a=1&b=2"
    with pytest.raises(ValueError, match="it has no pip-"):
        bootstrap.wheel_url("<a href='pip-9.0-py3-none-any.whl'>", "https://index.example/simple/pip/")


@pytest.fixture
def index(tmp_path: Path) -> Path:
    (tmp_path / "pip").mkdir()
    (tmp_path / "pip" / "index.html").write_text(f'<a href="{bootstrap.PIP_WHEEL}">')
    (tmp_path / "pip" / bootstrap.PIP_WHEEL).write_bytes(b"wheel")
    return tmp_path


def test_a_wheel_with_another_hash_is_refused(index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(bootstrap.BootstrapError, match="wrong SHA-256"):
        bootstrap.download_pip(index.as_uri())
    monkeypatch.setattr(bootstrap, "PIP_SHA256", hashlib.sha256(b"wheel").hexdigest())
    assert bootstrap.download_pip(index.as_uri()) == b"wheel"


def test_an_index_that_cannot_be_read_is_named_with_the_way_out_and_without_the_login(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unreachable(url: str) -> bytes:
        raise ConnectionRefusedError("connection refused")

    monkeypatch.setattr(bootstrap, "fetch", unreachable)
    with pytest.raises(bootstrap.BootstrapError) as caught:
        bootstrap.download_pip("https://me:secret@index.example/simple")
    message = str(caught.value)
    assert "index.example" in message
    assert "PIP_INDEX_URL" in message
    assert "secret" not in message


class LoginHandler(http.server.BaseHTTPRequestHandler):
    """Answers with the login that it was sent."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(self.headers.get("Authorization", "no login").encode())

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  # the base class names it so
        pass


@pytest.fixture
def server() -> Iterator[str]:
    with http.server.HTTPServer(("127.0.0.1", 0), LoginHandler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_login_in_the_address_is_sent_as_one(server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    assert bootstrap.fetch(f"http://{server}/") == b"no login"
    assert bootstrap.fetch(f"http://me:p%40ss@{server}/") == b"Basic bWU6cEBzcw=="  # base64 of me:p@ss


def test_settings_are_those_of_pip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = tmp_path / "pip.conf"
    config.write_text(
        "[global]\nindex-url = https://of.global\ncert = /global.pem\n[install]\nindex-url = https://of.install\n"
    )
    monkeypatch.setenv("PIP_CONFIG_FILE", str(config))
    assert bootstrap.setting("index-url") == "https://of.install"
    assert bootstrap.setting("cert") == "/global.pem"
    monkeypatch.setenv("PIP_INDEX_URL", "https://of.environment")
    assert bootstrap.setting("index-url") == "https://of.environment"
    monkeypatch.delenv("PIP_INDEX_URL")
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    assert bootstrap.setting("index-url") is None


# One line that says what is wrong


@pytest.mark.parametrize(
    ("output", "telling"),
    [
        ("WARNING: slow\nERROR: [Errno 28] No space left on device", "disk is full"),
        ("SSLError(1, '[SSL: CERTIFICATE_VERIFY_FAILED] certificate verify failed')", "PIP_CERT"),
        ("WARNING: Retrying after connection broken by 'NewConnectionError'\nERROR: No matching", "PIP_INDEX_URL"),
        ("ERROR: Could not find a version that satisfies gtsam (from versions: none)", "PIP_INDEX_URL"),
        ("  File x\nRuntimeError: the reason\nmore", "RuntimeError: the reason"),
        ("", "it said nothing"),
    ],
)
def test_a_failure_is_told_in_one_line(output: str, telling: str) -> None:
    text = bootstrap.reason(output)
    assert telling in text
    assert "\n" not in text


def test_a_command_that_fails_says_what_it_was_for(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(bootstrap.BootstrapError, match=r"^making tea failed: no kettle$"):
        bootstrap.run("making tea (a minute)", sys.executable, "-c", "import sys; sys.exit('no kettle')")
    assert capsys.readouterr().err == "bootstrap: making tea (a minute)\n"
