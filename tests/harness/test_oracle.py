"""The oracle itself, before it judges anything."""

import meshes
import numpy as np
import oracle
import pytest
import star


def bar():
    return oracle.Tissue(*meshes.kuhn((0.1, 0.02, 0.02), (5, 2, 2), jitter=0.2), 5e3, 0.3, 1000)


def test_uniaxial_stretch_is_exact():
    """A bar held on three symmetry planes stretches by E without error on an irregular mesh."""
    tissue = bar()
    held = np.abs(tissue.nodes) < 1e-12
    end = np.abs(tissue.nodes[:, 0] - 0.1) < 1e-12
    held[end, 0] = True
    u, reaction = oracle.statics(tissue, np.zeros(held.shape), held, np.where(end[:, None], [0.001, 0, 0], 0))
    exact = tissue.nodes * [0.01, -0.003, -0.003]
    assert np.abs(u - exact).max() < 1e-15
    assert reaction[end, 0].sum() == pytest.approx(5e3 * 0.01 * 0.0004, rel=1e-12)


def test_modal_and_numerical_histories_agree():
    """The exact modal motion and DOP853 give the same history."""
    tissue = bar()
    held = np.repeat(np.abs(tissue.nodes[:, :1]) < 1e-12, 3, axis=1)
    weight = tissue.weight([0, 0, -9.81])
    times = np.linspace(0, 0.1, 6)
    still = np.zeros(held.shape)
    modal = oracle.modal_history(tissue, 7.0, weight, held, still, times)
    driven = oracle.driven_history(tissue, 7.0, lambda t: weight, held, lambda t: still, None, times)
    assert np.abs(modal - driven).max() < 1e-8 * np.abs(modal).max()


def test_the_star_rule_by_hand():
    """Two pairs of tetrahedra that share a face each, and with one another a vertex, an edge, or a face."""
    pair = [[0, 1, 2, 3], [0, 1, 2, 4]]
    assert star.bad_stars(pair + [[0, 5, 6, 7], [0, 5, 6, 8]], range(4)) == [(0,)]
    assert set(star.bad_stars(pair + [[0, 1, 5, 6], [0, 1, 5, 7]], range(4))) == {(0,), (1,), (0, 1)}
    assert star.bad_stars(pair + [[0, 1, 3, 5], [0, 1, 5, 7]], range(4)) == []
    # Four round an edge: two opposite ones hang by it, and the smaller goes.
    nodes = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1.1, 0]], float)
    ring = [[0, 1, 2, 3], [0, 1, 3, 4], [0, 1, 4, 5], [0, 1, 5, 2]]
    nodes, ring = meshes.oriented(nodes, ring)
    assert star.bad_stars(ring, [1, 3]) == [(0,), (1,), (0, 1)]
    assert list(star.Tissue(nodes, ring).event([0]).left) == [1, 2, 3]
    assert list(star.Tissue(nodes, ring).event([0, 2]).left) == [3]
