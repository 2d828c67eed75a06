"""An engine as an FMU for co-simulation, FMI 2.0 or 3.0: C sources, their binary for this platform, a description.

FMI: https://fmi-standard.org, documents 2.0.4 and 3.0.1; the headers in `fmi/` are the standard's own.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

from dieseltwin.codegen.c_engine import c_source, input_columns, output_columns, source_text
from dieseltwin.codegen.transpile import number
from dieseltwin.engine.model_constants import PUBLISHED
from dieseltwin.engine.parameters import EngineParameters, constants, described
from dieseltwin.errors import DieselTwinError, InputError
from dieseltwin.symbols import BY_COLUMN
from dieseltwin.version import __version__

Version = Literal[2, 3]
VERSIONS: tuple[Version, ...] = (2, 3)
STEP_S = 0.05
"""Suggested communication step [s]: inputs that a master holds over it come half of it late."""

INPUT_STARTS = {"n_e_rpm": 1200.0, "u_delta_mg": 100.0, "u_egr_pct": 0.0, "u_vgt_pct": 60.0, "u_flap_pct": 100.0}
"""Values of the inputs before any is set: medium load [rpm, mg/cycle, %]."""

FLAGS = ("-O2", "-std=c99", "-fPIC", "-shared", "-fvisibility=hidden")
_PLATFORMS = {
    ("Linux", "x86_64"): ("linux64", "x86_64-linux", ".so"),
    ("Linux", "aarch64"): ("", "aarch64-linux", ".so"),
    ("Darwin", "x86_64"): ("darwin64", "x86_64-darwin", ".dylib"),
    ("Darwin", "arm64"): ("", "aarch64-darwin", ".dylib"),
}  # fmt: skip
"""System and processor -> folder of the binary in FMI 2 and in FMI 3, ending. FMI 2.0 names no ARM."""

_HEADERS = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
_STARTS = (("p_im_start", "Pa", "p_im"), ("p_em_start", "Pa", "p_em"), ("omega_t_start", "rad/s", "omega_t"))
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of the files in the archive: the same engine gives the same bytes


@dataclass(frozen=True)
class Variable:
    """A variable of the component.

    Attributes:
        name, unit, words: as people read it.
        reference: its number in `c/fmu.c`.
        causality: "independent", "input", "parameter" or "output".
        start: its value before any is set; None for an output.
    """

    name: str
    reference: int
    causality: str
    unit: str
    words: str
    start: float | None = None


def variables(engine: EngineParameters) -> list[Variable]:
    """All variables of an engine's FMU."""
    inputs = input_columns(engine)
    values, words = constants(engine)._asdict(), described()
    out = [Variable("time", 0, "independent", "s", "simulated time")]
    out += [Variable(name, 1 + j, "input", *_named(name), start=INPUT_STARTS[name]) for j, name in enumerate(inputs)]
    for j, name in enumerate(PUBLISHED):
        text, _, unit = words[name].partition(" [")
        out.append(Variable(name, 100 + j, "parameter", unit.partition("]")[0] or "-", text, values[name]))
    out += [Variable(name, 900 + j, "parameter", unit, f"{of} at the start; 0: at rest", 0.0)
            for j, (name, unit, of) in enumerate(_STARTS)]  # fmt: skip
    out += [Variable(name, 1000 + j, "output", *_named(name)) for j, name in enumerate(output_columns(engine))
            if name not in (*inputs, "time_s")]  # fmt: skip
    return out


def _named(column: str) -> tuple[str, str]:
    found = BY_COLUMN.get(column)
    if found is not None:
        return found.unit, found.meaning
    units = {"_pa": "Pa", "_k": "K", "_kg_s": "kg/s", "_w": "W", "_pct": "%"}
    return next((unit for end, unit in units.items() if column.endswith(end)), "-"), column


def write_fmu(engine: EngineParameters, name: str, out: Path, version: Version = 2, binary: bool = True) -> None:
    """Write an engine as an FMU.

    Args:
        engine: with its terms; name: of the model.
        out: the file; it is written whole or not at all by the caller's `atomic_path`.
        version: of FMI.
        binary: compile for this platform; else the FMU has its sources alone.

    Raises:
        InputError: no compiler, or a platform for which FMI names no folder.
    """
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    identifier = plain if plain[:1].isalpha() else f"engine_{plain}"
    source = fmu_source(engine, name, version)
    headers = {header: _header(header) for header in _HEADERS[version]}
    members = {"modelDescription.xml": description(engine, name, identifier, source, version)}
    members |= {f"sources/{file}": text.encode() for file, text in headers.items()}
    members[f"sources/{identifier}.c"] = source.encode()
    if version == 3:
        members["sources/buildDescription.xml"] = _build_description(identifier)
    if binary:
        folder, ending = _platform(version)
        members[f"binaries/{folder}/{identifier}{ending}"] = _compiled(source, headers)
    with zipfile.ZipFile(out, "w") as archive:
        for member, content in members.items():
            entry = zipfile.ZipInfo(member, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if member.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content)


def fmu_source(engine: EngineParameters, name: str, version: Version) -> str:
    """The one C file of an FMU: engine, component, functions of FMI."""
    plain = c_source(engine, name, command_line=False)
    starts = ", ".join(number(INPUT_STARTS[column]) for column in input_columns(engine))
    offered = source_text(f"fmi{version}.c")
    return "\n".join([
        plain, f'#define INPUT_STARTS {starts}\n#define IDENTITY "{_identity(plain)}"\n', source_text("fmu.c"), offered,
        "/* Not offered. */\n", *_stubs(version, offered),
    ])  # fmt: skip


def _stubs(version: Version, offered: str) -> Iterator[str]:
    """Functions that the standard's header declares and `offered` doesn't define: they return an error."""
    header = re.sub(r"/\*.*?\*/", "", _header(f"fmi{version}FunctionTypes.h"), flags=re.DOTALL)
    for name, arguments in re.findall(rf"typedef\s+fmi{version}Status\s+(\w+)TYPE\s*\(([^;]*)\);", header):
        if f" {name}(" not in offered:
            yield f"fmi{version}Status {name}({' '.join(arguments.split())})\n{{\n    return fmi{version}Error;\n}}\n"


def _identity(source: str) -> str:
    digest = hashlib.sha256(source.encode()).hexdigest()
    return "{" + "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32])) + "}"


def _header(name: str) -> str:
    return files("dieseltwin.codegen").joinpath(f"fmi/{name}").read_text(encoding="utf-8")


def description(engine: EngineParameters, name: str, identifier: str, source: str, version: Version) -> bytes:
    """modelDescription.xml."""
    identity = re.search(r'#define IDENTITY "(.*)"', source)
    if identity is None:
        raise DieselTwinError("the FMU's source has no identity")
    known = variables(engine)
    root = ElementTree.Element("fmiModelDescription", {
        "fmiVersion": f"{version}.0", "modelName": name, {2: "guid", 3: "instantiationToken"}[version]: identity[1],
        "generationTool": f"dieseltwin {__version__}", "variableNamingConvention": "flat",
        "description": "mean-value model of a diesel engine's gas path",
    })  # fmt: skip
    _capabilities(root, identifier, version)
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in sorted({variable.unit for variable in known} - {"-"}):
        ElementTree.SubElement(units, "Unit", name=unit)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stepSize=str(STEP_S))
    listed = ElementTree.SubElement(root, "ModelVariables")
    for variable in known:
        _describe(listed, variable, version)
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [(index, variable) for index, variable in enumerate(known, start=1) if variable.causality == "output"]
    if version == 2:
        for part in ("Outputs", "InitialUnknowns"):
            of = ElementTree.SubElement(structure, part)
            for index, _ in outputs:
                ElementTree.SubElement(of, "Unknown", index=str(index))
    else:
        for part in ("Output", "InitialUnknown"):
            for _, variable in outputs:
                ElementTree.SubElement(structure, part, valueReference=str(variable.reference))
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True))


def _capabilities(root: ElementTree.Element, identifier: str, version: Version) -> None:
    state = {2: "canGetAndSetFMUstate", 3: "canGetAndSetFMUState"}[version]
    offered = ElementTree.SubElement(root, "CoSimulation", {
        "modelIdentifier": identifier, "canHandleVariableCommunicationStepSize": "true", state: "true",
    })  # fmt: skip
    if version == 2:
        offered.set("canInterpolateInputs", "true")
        sources = ElementTree.SubElement(offered, "SourceFiles")
        ElementTree.SubElement(sources, "File", name=f"{identifier}.c")


def _describe(listed: ElementTree.Element, variable: Variable, version: Version) -> None:
    about = {"name": variable.name, "valueReference": str(variable.reference), "causality": variable.causality,
             "description": variable.words,
             "variability": "fixed" if variable.causality == "parameter" else "continuous"}  # fmt: skip
    initial = {"output": "calculated", "parameter": "exact"}.get(variable.causality)
    if initial:
        about["initial"] = initial
    value = {} if variable.start is None else {"start": repr(variable.start)}
    if variable.unit != "-":
        value["unit"] = variable.unit
    if version == 3:
        ElementTree.SubElement(listed, "Float64", about | value)
    else:
        ElementTree.SubElement(ElementTree.SubElement(listed, "ScalarVariable", about), "Real", value)


def _build_description(identifier: str) -> bytes:
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    sources = ElementTree.SubElement(build, "SourceFileSet", language="C99")
    ElementTree.SubElement(sources, "SourceFile", name=f"{identifier}.c")
    ElementTree.SubElement(build, "Library", name="m")
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True))


def check_platform(version: Version) -> None:
    """Make sure that an FMU's binary can be compiled, before anything is written.

    Raises:
        InputError: no compiler, or a platform for which FMI names no folder.
    """
    _platform(version)
    compiler()


def _platform(version: Version) -> tuple[str, str]:
    machine = (platform.system(), platform.machine())
    two, three, ending = _PLATFORMS.get(machine, ("", "", ""))
    folder = two if version == 2 else three
    if not folder:
        raise InputError("--fmu", f"{machine[0]} on {machine[1]}", f"a platform that FMI {version}.0 names",
                         "add --sources-only, or take --fmi 3")
    return folder, ending


def compiler() -> str:
    """The C compiler: CC, or else gcc, cc or clang.

    Raises:
        InputError: none is found.
    """
    named = os.environ.get("CC")
    found = next((c for c in ((named,) if named else ("gcc", "cc", "clang")) if shutil.which(c)), None)
    if found is None:
        raise InputError("--fmu", f"no C compiler ({named or 'gcc, cc, clang'})", "one on the path, or named by CC",
                         "install gcc, or add --sources-only")
    return found


def _compiled(source: str, headers: dict[str, str]) -> bytes:
    command = compiler()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, text in {**headers, "fmu.c": source}.items():
            (folder / name).write_text(text, encoding="utf-8")
        made = folder / "fmu.bin"
        done = subprocess.run([command, *FLAGS, "-o", str(made), str(folder / "fmu.c"), "-lm"], capture_output=True,
                              text=True, check=False)  # fmt: skip
        if done.returncode:
            first = next((line for line in done.stderr.splitlines() if "error" in line), "failed")
            raise InputError("--fmu", f"{command}: {first.replace(scratch, '')}", "a compiler of C99",
                             "set CC to another one, or add --sources-only")
        return made.read_bytes()
