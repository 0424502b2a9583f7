"""The Containerfile has what Skyline needs; no container is built here."""

import re
import runpy
import tomllib

from documents import ROOT

FILE = (ROOT / "Containerfile").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
COPIED = {
    path for line in re.findall(r"^COPY (.+) \S+$", FILE, re.MULTILINE) for path in line.split()
}


def test_it_installs_one_whole_way_to_opengl():
    installed = set(re.search(r"--no-install-recommends (.+) \\$", FILE, re.MULTILINE)[1].split())
    needs = runpy.run_path(str(ROOT / ".ci" / "system_packages.py"))
    assert installed < needs["NEEDS"].keys()
    left_out = needs["NEEDS"].keys() - installed - {"python3-venv"}
    assert needs["can_do_without"](left_out)


def test_it_copies_what_the_package_is_built_from():
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    project = PROJECT["project"]
    built_from = {*wheel["packages"], *wheel["force-include"], project["readme"]}
    assert built_from | {"pyproject.toml", project["license"]["file"]} == COPIED
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    assert {line[1:] for line in ignored if line.startswith("!")} == COPIED
