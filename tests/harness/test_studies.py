"""The studies mean the same to the product and to the oracle."""

import numpy as np
import pytest
from meshes import volumes
from nonlinear import Material
from studies import STUDIES


@pytest.mark.parametrize("study", STUDIES, ids=lambda f: f.__name__)
def test_reference_meets_the_oracle(study, reference):
    """Linear law, constant strain, coarse: the same displacement, force or torque."""
    study = study()
    problem = study.problem(0.4, "linear", 0.45, element="constantStrain")
    nodes, mesh = problem.nodes, (problem.nodes, problem.tetrahedra)
    force, _, known = study.oracle(None, "linear", 0.45, mesh=mesh, floor=-np.inf)
    found = reference(problem.scene)
    reaction = np.zeros(nodes.shape)
    for node, value in found["reaction"].items():
        reaction[int(node)] = value
    u = np.array(found["displacement"])
    assert np.abs(u - known.displacement).max() < 1e-9 * np.abs(u).max()
    assert study.measured(nodes, u, reaction) == pytest.approx(force, rel=1e-8)


@pytest.mark.parametrize("study", STUDIES, ids=lambda f: f.__name__)
def test_meshes_fill_the_body(study):
    """Whole or graded and cut at its symmetry: the same volume, and about 7 000 tetrahedra."""
    study = study()
    whole = volumes(*study.mesh(1))
    nodes, cells, element = study.own(1)
    weight = element(nodes, cells, Material("stableNeoHookean", 1.0, 1.0)).weight
    assert study.share * weight.sum() == pytest.approx(whole.sum(), rel=1e-12)
    assert min(whole.min(), weight.min()) > 0
    assert 6500 < len(whole) < 7500
