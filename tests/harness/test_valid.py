"""modelDescription.xml: what FMPy checks, and what no validator does."""

import re
import subprocess
import sys
import zipfile
from xml.etree import ElementTree

import pytest
from fmpy.validation import validate_fmu
from scenes import plate, three_tools


def surface_only():
    problem = plate("surface_only")
    problem.scene["outputs"] = {"vertices": "surface", "causality": "local", "triangles": True}
    return problem


def silent():
    problem = plate("silent", cells=(2, 1, 1))
    problem.scene |= {"outputs": {"vertices": "none"}, "description": "a < b & \"c\" > 'd' ü %s"}
    return problem


def rich():
    problem = three_tools("rich")
    problem.material([0, 1, 2], 5e3, 0.4, 1000)
    problem.scene["outputs"] = {"vertices": "all", "causality": "output", "triangles": True}
    return problem.cut([5], 0.1)


SCENES = [surface_only, silent, rich]


@pytest.fixture(params=SCENES, ids=lambda f: f.__name__)
def fmu(request, build):
    return build(request.param().scene)


@pytest.fixture
def xml(fmu):
    with zipfile.ZipFile(fmu.path) as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml"))


def test_fmpy_finds_no_problem(fmu):
    """validate_fmu returns an empty list."""
    assert validate_fmu(fmu.path) == []


def test_fmpy_command_is_silent(build):
    """`python -m fmpy validate` exits 0 and complains of nothing."""
    done = subprocess.run([sys.executable, "-m", "fmpy", "validate", build(silent().scene).path],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.sub(r"(?i)no problems found\.?|validating.*", "", done.stdout + done.stderr).strip() == ""


def test_layout(fmu):
    """The archive holds what hosts look for, under relative names, and the binary exports FMI 2.0."""
    with zipfile.ZipFile(fmu.path) as archive:
        names = archive.namelist()
        assert archive.testzip() is None
    assert names.count("modelDescription.xml") == 1
    name = fmu.description.modelName
    assert fmu.description.coSimulation.modelIdentifier == name
    assert f"binaries/linux64/{name}.so" in names
    assert not [n for n in names if n.startswith("/") or ".." in n or "\\" in n]


def test_references_are_unique(xml):
    """No two variables of a type share a value reference, and no two share a name."""
    seen = [(v[0].tag, v.get("valueReference")) for v in xml.find("ModelVariables")]
    assert len(seen) == len(set(seen))
    names = [v.get("name") for v in xml.find("ModelVariables")]
    assert len(names) == len(set(names))


def test_arrays_have_consecutive_references(fmu):
    """Vertices, nodes and triangles can be read as one block."""
    for pattern in (r"surface\.vertex\[(\d+)\]\.([xyz])$", r"surface\.node\[(\d+)\]$", r"surface\.triangle\[(\d+),(\d)\]$"):
        found = [fmu.reference[n] for n in fmu.variables if re.match(pattern, n)]
        assert found == list(range(found[0], found[0] + len(found))) if found else True
    for tool in range(1, 4):
        for array in ("position", "force", "torque", "meanForce"):
            found = [fmu.reference[n] for n in fmu.variables if n.startswith(f"tool[{tool}].{array}.")]
            assert not found or found == [found[0], found[0] + 1, found[0] + 2]


def test_every_variable_says_what_it_is(xml):
    """Causality, variability, description; a start exactly where the standard wants one; initial where it must be said."""
    for v in xml.find("ModelVariables"):
        name, causality, variability, initial = (v.get(k) for k in ("name", "causality", "variability", "initial"))
        assert causality and variability and v.get("description"), name
        start = v[0].get("start")
        exact = causality == "input" or initial in ("exact", "approx")
        assert (start is not None) == exact, name
        assert initial in {"input": (None,), "parameter": ("exact",)}.get(causality, ("calculated", "exact")), name
        assert variability in {"input": ("continuous", "discrete"), "parameter": ("fixed", "tunable"),
                               "output": ("continuous", "discrete"),
                               "local": ("continuous", "discrete", "fixed", "tunable")}[causality], name
        if v[0].tag != "Real":
            assert variability != "continuous", name


def test_starts_lie_in_range(xml):
    """min <= start <= max for every variable that has them."""
    for v in xml.find("ModelVariables"):
        low, start, high = (v[0].get(k) for k in ("min", "start", "max"))
        if low is not None and high is not None:
            assert float(low) <= float(high)
        if start is not None and v[0].tag != "Boolean":
            assert float(low or "-inf") <= float(start) <= float(high or "inf"), v.get("name")


def test_units_are_defined(xml):
    """Every Real has a unit, every unit is defined with its base units, and they are the SI ones."""
    units = {u.get("name"): u.find("BaseUnit") for u in xml.find("UnitDefinitions")}
    reals = [v for v in xml.find("ModelVariables") if v[0].tag == "Real"]
    for v in reals:
        assert units.get(v[0].get("unit")) is not None, v.get("name")
    exponents = {"m": {"m": 1}, "N": {"kg": 1, "m": 1, "s": -2}, "J": {"kg": 1, "m": 2, "s": -2}, "s": {"s": 1},
                 "Pa": {"kg": 1, "m": -1, "s": -2}, "kg/m3": {"kg": 1, "m": -3}, "1/s": {"s": -1}, "m3": {"m": 3},
                 "N.m": {"kg": 1, "m": 2, "s": -2}, "m/s2": {"m": 1, "s": -2}, "1": {}, "Hz": {"s": -1}}
    for name, base in units.items():
        if name in exponents:
            assert {k: int(x) for k, x in base.items()} == exponents[name], name
    expected = {"energy.elastic": "J", "gravity.z": "m/s2", "integration.damping": "1/s", "topology.removedVolume": "m3",
                "material[1].youngModulus": "Pa", "material[1].density": "kg/m3", "diagnostics.substep": "s",
                "integration.hapticRate": "Hz", "diagnostics.minimumVolumeRatio": "1"}
    found = {v.get("name"): v[0].get("unit") for v in reals}
    assert {n: found[n] for n in expected} == expected


def test_structure_is_complete(xml):
    """Outputs are all outputs; InitialUnknowns are exactly the calculated outputs, in order."""
    variables = list(xml.find("ModelVariables"))

    def listed(name):
        element = xml.find(f"ModelStructure/{name}")
        return [] if element is None else [int(u.get("index")) for u in element]

    outputs = [k + 1 for k, v in enumerate(variables) if v.get("causality") == "output"]
    calculated = [k for k in outputs if variables[k - 1].get("initial") in ("calculated", "approx")]
    assert listed("Outputs") == outputs
    assert listed("InitialUnknowns") == calculated


def test_what_the_contract_names_is_there(build):
    """Every variable of the contract exists with its type, causality and variability."""
    fmu = build(rich().scene)
    table = {
        "tool[{i}].position.{x}": ("Real", "input", "continuous"),
        "tool[{i}].orientation.{w}": ("Real", "input", "continuous"),
        "tool[{i}].active": ("Boolean", "input", "discrete"),
        "tool[{i}].force.{x}": ("Real", "output", "continuous"),
        "tool[{i}].torque.{x}": ("Real", "output", "continuous"),
        "tool[{i}].meanForce.{x}": ("Real", "output", "continuous"),
        "tool[{i}].inContact": ("Boolean", "output", "discrete"),
        "surface.vertex[{i}].{x}": ("Real", "output", "continuous"),
        "surface.node[{i}]": ("Integer", "local", "fixed"),
        "surface.triangle[{i},1]": ("Integer", "local", "discrete"),
        "surface.triangleCount": ("Integer", "output", "discrete"),
        "topology.revision": ("Integer", "output", "discrete"),
        "topology.removedTetrahedra": ("Integer", "output", "discrete"),
        "topology.pieces": ("Integer", "output", "discrete"),
        "topology.removedVolume": ("Real", "output", "discrete"),
        **{f"energy.{e}": ("Real", "output", "continuous")
           for e in ("elastic", "kinetic", "gravity", "load", "toolWork", "supportWork", "dissipated")},
        "diagnostics.substeps": ("Integer", "output", "discrete"),
        "diagnostics.substep": ("Real", "output", "discrete"),
        "diagnostics.criticalSubstep": ("Real", "output", "discrete"),
        "diagnostics.minimumVolumeRatio": ("Real", "output", "continuous"),
        "diagnostics.nonlinearFraction": ("Real", "output", "continuous"),
        "gravity.{x}": ("Real", "parameter", "tunable"),
        "integration.damping": ("Real", "parameter", "tunable"),
        "integration.hapticRate": ("Real", "parameter", "fixed"),
        "material[1].youngModulus": ("Real", "parameter", "fixed"),
        "material[2].poissonRatio": ("Real", "parameter", "fixed"),
        "material[2].density": ("Real", "parameter", "fixed"),
    }
    for pattern, expected in table.items():
        names = {pattern.format(i=i, x=x, w=w) for i in (1, 2, 3) for x in "xyz" for w in "wxyz"}
        for name in names:
            v = fmu.variables[name]
            assert (v.type, v.causality, v.variability) == expected, name


def test_start_values_are_those_of_the_scene(build):
    """Pose, gravity, damping, rate and materials start as the scene says, and read back so."""
    from fmu import Instance

    problem = rich().set(integration={"damping": 12.5, "hapticRate": 500})
    fmu = build(problem.scene)
    with Instance(fmu) as instance:
        expected = {"integration.damping": 12.5, "integration.hapticRate": 500.0, "gravity.z": -0.5,
                    "material[1].youngModulus": 6000.0, "material[2].poissonRatio": 0.4, "tool[1].position.x": 0.045,
                    "tool[2].orientation.x": 1.0, "tool[2].orientation.w": 0.0}
        for name, value in expected.items():
            assert float(fmu.variables[name].start) == value, name
            assert instance.get(name) == value, name
        assert instance.get("tool[1].active") == 0
        assert instance.get("topology.pieces") == 1


def test_experiment_is_the_haptic_period(xml):
    """The default experiment suggests a step, and the flags say what the FMU can do."""
    experiment, slave = xml.find("DefaultExperiment"), xml.find("CoSimulation")
    assert float(experiment.get("stepSize")) == 1e-3
    for flag in ("canHandleVariableCommunicationStepSize", "canInterpolateInputs", "canGetAndSetFMUstate",
                 "canSerializeFMUstate"):
        assert slave.get(flag) == "true"
    assert xml.get("variableNamingConvention") == "structured"
    assert not set("{}") & set(xml.get("guid"))


def test_builds_are_reproducible(command, written, tmp_path):
    """The same scene gives the same modelDescription, guid included; another scene another guid."""
    texts = []
    for name, problem in (("a", plate("twin")), ("b", plate("twin")), ("c", plate("twin", gravity=[0, 0, -1]))):
        target = tmp_path / f"{name}.fmu"
        assert command("build", written(problem.scene), "-o", target).returncode == 0
        with zipfile.ZipFile(target) as archive:
            texts.append(archive.read("modelDescription.xml"))
    assert texts[0] == texts[1]
    guids = [ElementTree.fromstring(t).get("guid") for t in texts]
    assert guids[0] != guids[2]
