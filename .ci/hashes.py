"""Add the hashes of a release's archives to the pins of lock files: `make lock` runs it.

Run with pip's own Python, as its internals find the package index that it is configured for.
"""

import re
import sys
from pathlib import Path

from pip._internal.commands import create_command
from pip._internal.index.collector import LinkCollector, parse_links
from pip._internal.models.link import Link
from pip._vendor.packaging.utils import (
    canonicalize_name,
    parse_sdist_filename,
    parse_wheel_filename,
)

PIN = re.compile(r"([\w.-]+)==([\w.!+]+)(.*)")
PYTHONS = {"py3", *(f"cp3{minor}" for minor in range(11, 15))}


def serves(name: str) -> bool:
    """Return whether a wheel is for one of the Pythons here on Linux."""
    _, _, _, tags = parse_wheel_filename(name)
    return any(
        (tag.platform == "any" or "linux" in tag.platform)
        and (tag.interpreter in PYTHONS or tag.abi == "abi3")  # of any Python since
        for tag in tags
    )


def hashes(collector: LinkCollector, name: str, version: str) -> list[str]:
    """Return the SHA-256 of each wheel of a release that may be used here, and of its source.

    Only the first index counts: what others offer under the same names must be the same files.
    """
    wheels, sources = [], []
    page = collector.fetch_response(
        Link(collector.search_scope.get_index_urls_locations(canonicalize_name(name))[0])
    )
    for link in parse_links(page) if page else ():
        try:
            if link.filename.endswith(".whl"):
                _, found, _, _ = parse_wheel_filename(link.filename)
                group = wheels if serves(link.filename) else []
            else:
                _, found = parse_sdist_filename(link.filename)
                group = sources
        except ValueError:  # an archive of another kind
            continue
        if str(found) == version and link.hash_name == "sha256":
            group.append(link.hash)
    if not (chosen := wheels + sources):
        sys.exit(f"{name}=={version} must have an archive with a hash in the package index")
    return sorted(chosen)


def main(locks: list[str]) -> None:
    """Write the hashes into lock files, in place of those that are there."""
    command = create_command("download")
    options, _ = command.parse_args([])
    with command.main_context():
        session = command._build_session(options)
        collector = LinkCollector.create(session, options)
        for lock in map(Path, locks):
            lines: list[str] = []
            for line in lock.read_text(encoding="utf-8").splitlines():
                if found := PIN.match(line):
                    name, version, marker = found[1], found[2], found[3].rstrip("\\ ")
                    lines += [f"{name}=={version}{marker} \\"]
                    found_hashes = hashes(collector, name, version)
                    lines += [f"    --hash=sha256:{one} \\" for one in found_hashes]
                    lines[-1] = lines[-1].removesuffix(" \\")
                elif not line.lstrip().startswith("--hash"):
                    lines.append(line)
            lock.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
