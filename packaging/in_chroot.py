"""Goes through a Dockerfile or an Apptainer definition without either: python3 packaging/in_chroot.py FILE FOLDER.

As root, from the root of a checkout. FOLDER holds a bare Debian 12, as debootstrap makes it, and is changed:

    debootstrap --variant=minbase bookworm FOLDER
    python3 packaging/in_chroot.py packaging/Dockerfile FOLDER

It copies the files, and runs the commands with the environment and the user of each; what else stands in FILE is left
out. Words NAME=VALUE after FOLDER are added to the environment, such as that of a proxy. Ends with the status of the
first command that fails.
"""

import shlex
import shutil
import subprocess
import sys
from pathlib import Path

PATH = "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


def copy(source, target):
    """Copy a file or a folder of the checkout into the image."""
    if source.is_dir():
        left = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
        shutil.copytree(source, target, dirs_exist_ok=True, ignore=left)
    else:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, target)


def of_dockerfile(text):
    """Yield what a Dockerfile does: ("copy", from, to), ("run", command, environment, user)."""
    environment, user = [], "root"
    for line in text.splitlines():
        word, _, rest = line.partition(" ")
        if word == "COPY":
            *sources, target = rest.split()
            for source in sources:
                yield "copy", source, target + Path(source).name if target.endswith("/") else target
        elif word == "ENV":
            environment += shlex.split(rest)
        elif word == "USER":
            user = rest
        elif word == "RUN":
            yield "run", rest, list(environment), user


def of_definition(text):
    """Yield what an Apptainer definition does: its files, %post, and %test with %environment."""
    sections, now = {}, None
    for line in text.splitlines():
        if line.startswith("%"):
            now = sections.setdefault(line[1:].strip(), [])
        elif now is not None:
            now.append(line)
    for line in filter(None, map(str.strip, sections["files"])):
        yield ("copy", *line.split())
    # Apptainer ends each of them at the first command that fails.
    yield "run", "\n".join(["set -e", *sections["post"]]), [], "root"
    yield "run", "\n".join(["set -e", *sections["environment"], *sections["test"]]), [], "root"


def main():
    """Go through the file that the command line names."""
    file, folder, *added = sys.argv[1:]
    read = of_definition if file.endswith(".def") else of_dockerfile
    for what, *words in read(Path(file).read_text()):
        print("==", what, *words[:2], flush=True)
        if what == "copy":
            copy(Path(words[0]), Path(folder) / words[1].lstrip("/"))
            continue
        command, environment, user = words
        home = "HOME=/root" if user == "root" else f"HOME=/home/{user}"
        chroot = ["/usr/sbin/chroot", f"--userspec={user}", folder]
        done = subprocess.run(
            ["env", "-i", PATH, home, *added, *environment, *chroot, "/bin/sh", "-c", f"cd /; {command}"], check=False
        )
        if done.returncode:
            sys.exit(done.returncode)


if __name__ == "__main__":
    main()
