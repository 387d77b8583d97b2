#!/usr/bin/env python3
"""Run one of the project's programs from .venv, which is made and filled first where that is needed.

    python3 bootstrap.py fieldloc compare    # a program, with its arguments
    python3 bootstrap.py pytest              # a tool of the tests: their extra packages are installed too

It needs Python >= 3.11 and a package index (pip's own: PIP_INDEX_URL, pip.conf), nothing else: no pip, no venv package
of the distribution, no root. A .venv that is up to date costs nothing, a broken one is made anew.
"""

import sys


def python_complaint(version: "tuple[int, ...]", platform: str) -> str:  # quoted: an old Python must get this far
    """What to tell a person whose Python cannot run the project; an empty text if it can."""
    if version < (3, 11):
        text = "fieldloc needs Python >= 3.11, this is {}.{}: run it with a newer one, as in python3.12 bootstrap.py"
        return text.format(*version)
    if platform == "win32":
        return "fieldloc runs on Linux and macOS (gtsam has no wheels for Windows): run it inside WSL"
    return ""


if __name__ == "__main__" and python_complaint(sys.version_info[:2], sys.platform):
    sys.exit("bootstrap: " + python_complaint(sys.version_info[:2], sys.platform))

import base64
import configparser
import fcntl
import html
import http.client
import os
import re
import shutil
import ssl
import subprocess
import tempfile
import time
from hashlib import sha256
from pathlib import Path
from urllib.parse import unquote, urldefrag, urljoin, urlsplit
from urllib.request import HTTPSHandler, ProxyHandler, Request, build_opener

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
STAMP = VENV / ".bootstrap"  # what was installed; empty while it is being installed
TEST_TOOLS = ("pytest", "ruff", "mypy", "lint-imports", "pyproject-build", "evo_ape", "evo_rpe")

# The pip of a machine that has none. The pinned hash vouches for the file, whoever serves it.
PIP_WHEEL = "pip-26.2.1-py3-none-any.whl"
PIP_SHA256 = "71138adf1f4ca900cdb7d289c21b7494329f2332b6d85f0e1c42108c0384ed3e"
WAY_OUT = "behind a mirror or a proxy set PIP_INDEX_URL, PIP_CERT or https_proxy; then run this again"


class BootstrapError(Exception):
    """One line for the person: what failed, and the way out."""


def main(arguments: list[str]) -> None:
    """Prepare .venv and become the program."""
    if arguments[:1] in ([], ["-h"], ["--help"]):
        sys.exit(__doc__)
    lock = os.open(ROOT, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)  # a second one waits here until the first has filled .venv
    prepare(with_tests=arguments[0] in TEST_TOOLS)
    os.close(lock)
    program = VENV / "bin" / arguments[0]
    if not program.exists():
        raise BootstrapError(f"there is no program {arguments[0]!r} in {program.parent}")
    os.environ["PATH"] = f"{program.parent}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    os.execve(program, [str(program), *arguments[1:]], os.environ | {"VIRTUAL_ENV": str(VENV)})


def prepare(with_tests: bool) -> None:
    """Make .venv hold the project and its needs, unless the stamp says that it does."""
    here = digest(f"{sys.version_info[:2]} {sys.base_prefix} {ROOT}".encode())  # another one: .venv is made anew
    needs = digest((ROOT / "pyproject.toml").read_bytes())  # another one: .venv is brought up to date
    stamp = STAMP.read_text().split() if STAMP.exists() else None
    if PYTHON.exists() and stamp in ([here, needs, "test"], [here, needs] + ["test"] * with_tests):
        return
    same_version = f"import sys; sys.exit(sys.version_info[:2] != {sys.version_info[:2]})"
    if not (PYTHON.exists() and (stamp is None or stamp[:1] == [here]) and works("-c", same_version)):
        shutil.rmtree(VENV, ignore_errors=True)
        VENV.mkdir()
        STAMP.touch()
        run(f"making {VENV}", sys.executable, "-m", "venv", "--without-pip", VENV)
    STAMP.write_text("")
    if not works("-m", "pip", "--version"):
        install_pip()
    extra = "[test]" if with_tests or "test" in (stamp or []) else ""
    what = f"installing fieldloc{extra} into {VENV} (a minute or two, up to 1 GB)"
    options = ("--quiet", "--no-input", "--disable-pip-version-check", "--editable")
    run(what, PYTHON, "-m", "pip", "install", *options, f".{extra}")
    STAMP.write_text(f"{here} {needs} {extra.strip('[]')}")


def install_pip() -> None:
    """Put pip into .venv: Python's own copy (Debian packs it apart), else by the system's pip, else from the index."""
    by_system = [sys.executable, "-m", "pip", "--python", str(PYTHON), "install", "pip"]  # from pip 22.3
    if works("-m", "ensurepip") or subprocess.run(by_system, env=environment(), capture_output=True).returncode == 0:
        return
    with tempfile.TemporaryDirectory() as folder:
        wheel = Path(folder) / PIP_WHEEL
        wheel.write_bytes(download_pip(setting("index-url") or "https://pypi.org/simple"))
        run("installing pip", PYTHON, wheel / "pip", "install", "--quiet", "--no-index", wheel)


def works(*arguments: str) -> bool:
    return subprocess.run([PYTHON, *arguments], env=environment(), capture_output=True).returncode == 0


def run(what: str, *command: str | Path) -> None:
    """Run a command silently beside a line that says what goes on; its failure becomes one line with the way out."""
    print(f"bootstrap: {what}", file=sys.stderr)
    start_s = time.monotonic()
    with tempfile.TemporaryFile("w+", errors="replace") as output:
        quiet = subprocess.DEVNULL
        with subprocess.Popen(
            command, cwd=ROOT, env=environment(), stdin=quiet, stdout=output, stderr=output
        ) as process:
            while process.poll() is None:
                time.sleep(0.2)
                if sys.stderr.isatty():
                    print(f"{time.monotonic() - start_s:.0f} s", end="\r", file=sys.stderr, flush=True)
        output.seek(0)
        if process.returncode:
            raise BootstrapError(f"{what.partition(' (')[0]} failed: {reason(output.read())}")


def reason(output: str) -> str:
    """The line of a failed command that tells most, and what helps."""
    lines = [line.strip() for line in output.splitlines() if line.strip()] or ["it said nothing"]
    last = ([line for line in lines if re.match(r"(\w*Error|ERROR)\b", line)] or lines)[-1]
    if "No space left" in output or "quota exceeded" in output:
        return f"the disk is full: free 2 GB for {ROOT} and for temporary files (TMPDIR); then run this again"
    if "CERTIFICATE_VERIFY_FAILED" in output:
        return f"the package index has a certificate that this machine does not trust: {WAY_OUT}"
    if "connection broken by" in output or "from versions: none" in output:
        return f"the package index cannot be reached or lacks a package ({last}): {WAY_OUT}"
    return last


def environment() -> dict[str, str]:
    """The environment for pip, without what would make it install elsewhere."""
    dropped = ("PYTHONHOME", "PYTHONPATH", "PIP_PREFIX", "PIP_PYTHON", "PIP_REQUIRE_VIRTUALENV", "PIP_TARGET")
    return {name: value for name, value in os.environ.items() if name not in dropped} | {"PIP_USER": "0"}


def setting(name: str) -> str | None:
    """An option of pip as pip would find it: from its environment variable, else from pip.conf."""
    user = os.environ.get("XDG_CONFIG_HOME", "~/.config") + "/pip/pip.conf"
    files = ["/etc/xdg/pip/pip.conf", "/etc/pip.conf", "~/.pip/pip.conf", user, os.environ.get("PIP_CONFIG_FILE", "")]
    config = configparser.RawConfigParser()
    if files[-1] != os.devnull:  # pip's way to say: no files
        config.read(os.path.expanduser(file) for file in files)
    in_file = config.get("install", name, fallback=None) or config.get("global", name, fallback=None)
    return os.environ.get("PIP_" + name.upper().replace("-", "_")) or in_file


def download_pip(index: str) -> bytes:
    """The pinned wheel of pip, from a package index."""
    page_url = f"{index.rstrip('/')}/pip/" + ("index.html" if index.startswith("file:") else "")
    host = urlsplit(index).hostname or index  # not the address: it may hold a login
    try:
        wheel = fetch(wheel_url(fetch(page_url).decode(), page_url))
    except (OSError, ValueError, http.client.HTTPException) as error:
        raise BootstrapError(f"pip is missing and could not be fetched from {host} ({error}): {WAY_OUT}") from error
    if digest(wheel) != PIP_SHA256:
        raise BootstrapError(f"{PIP_WHEEL} from {host} has the wrong SHA-256: {WAY_OUT}")
    return wheel


def wheel_url(page: str, page_url: str) -> str:
    """The address of pip's wheel on an index page (PEP 503: one link a file, its hash in the fragment)."""
    for link in re.findall(r"""<a\s[^>]*?href\s*=\s*["']([^"']+)""", page, re.IGNORECASE):
        url = urldefrag(urljoin(page_url, html.unescape(link))).url
        if urlsplit(url).path.rpartition("/")[2] == PIP_WHEEL:
            return url
    raise ValueError(f"it has no {PIP_WHEEL}")


def fetch(url: str) -> bytes:
    """The content of an address; a login in the address is sent as one."""
    parts = urlsplit(url)
    address = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
    request = Request(address, headers={"User-Agent": "fieldloc-bootstrap"})
    if parts.username:
        login = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        request.add_unredirected_header("Authorization", "Basic " + base64.b64encode(login.encode()).decode())
    cert = setting("cert") or os.environ.get("REQUESTS_CA_BUNDLE")
    context = ssl.create_default_context(cafile=cert)
    store = ssl.get_default_verify_paths()
    if not (cert or parts.username or store.cafile or (store.capath and os.listdir(store.capath))):
        # A bare machine has no certificates at all. What is fetched is checked by its hash, and no login is sent.
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    proxy = setting("proxy")
    proxies = ProxyHandler({"http": proxy, "https": proxy} if proxy else None)  # None: those of the environment
    with build_opener(proxies, HTTPSHandler(context=context)).open(request, timeout=60) as response:
        content: bytes = response.read()
    return content


def digest(data: bytes) -> str:
    return sha256(data).hexdigest()


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except BootstrapError as error:
        sys.exit(f"bootstrap: {error}")
    except configparser.Error as error:
        sys.exit(f"bootstrap: pip.conf cannot be read: {error}")
    except OSError as error:
        sys.exit(f"bootstrap: {error}: {ROOT} must be a folder where you may write, with 2 GB free")
    except KeyboardInterrupt:
        print("\nbootstrap: interrupted; run it again to go on", file=sys.stderr)
        sys.exit(130)
