import numpy as np

from data.fabrics.fabrics import fabric_from_theta, from_theta, read_fabric_table, to_theta

HEADER = (
    "density[kg.m-2], linear warp[SI*1e9], linear weft[SI*1e9], linear diag[SI*1e9], "
    "nonlinear warp[SI*1e12], nonlinear weft[SI*1e12], nonlinear diag[SI*1e12]"
)
STIFF = "0.15, 9000, 4000, 6000, -900, -400, -600"
SOFT = "0.30, 2000, 1000, 1500, -20, -10, 15"


def write(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def test_order_units_and_normalisation(tmp_path):
    table = read_fabric_table(write(tmp_path / "t.csv", HEADER, STIFF, SOFT))
    # 150 g/m² to 300 g/m² doubles the moduli; the file's order is warp, weft, bias.
    np.testing.assert_allclose(table.alpha[0], [18e-6, 12e-6, 8e-6])
    np.testing.assert_allclose(table.beta[0], [-1.8e-9, -1.2e-9, -0.8e-9])
    np.testing.assert_allclose(table.alpha[1], [2e-6, 1.5e-6, 1e-6])
    assert table.beta[1, 1] > 0
    np.testing.assert_allclose(table.density, [0.15, 0.30])


def test_repeated_rows_are_one_fabric(tmp_path):
    table = read_fabric_table(write(tmp_path / "t.csv", HEADER, STIFF, SOFT, "", STIFF, STIFF))
    assert len(table) == 2
    assert table.multiplicity.tolist() == [3, 1]


def test_multiplicity_column_counts(tmp_path):
    path = write(tmp_path / "t.csv", HEADER + ",rows in it", STIFF + ",4", SOFT + ",2")
    assert read_fabric_table(path).multiplicity.tolist() == [4, 2]


def test_columns_are_found_by_name(tmp_path):
    names, cells = HEADER.split(", "), STIFF.split(", ")
    shuffled = [", ".join(reversed(row)) for row in (names, cells)]
    there = read_fabric_table(write(tmp_path / "a.csv", *shuffled))
    here = read_fabric_table(write(tmp_path / "b.csv", HEADER, STIFF))
    np.testing.assert_array_equal(there.theta, here.theta)


def test_theta_and_back():
    alpha = np.array([[30e-6, 20e-6, 10e-6], [1e-6, 2e-6, 3e-6]])
    beta = np.array([[-90e-9, 20e-9, 0.0], [-1e-9, -2e-9, -3e-9]])
    theta = to_theta(alpha, beta)
    np.testing.assert_allclose(theta[0], [*np.log(alpha[0]), -3e-3, 1e-3, 0])
    for there, back in zip((alpha, beta), from_theta(theta), strict=True):
        np.testing.assert_allclose(back, there, rtol=1e-14)
    fabric = fabric_from_theta(theta[0])
    np.testing.assert_allclose(fabric.alpha, alpha[0])
    assert fabric.density == 0.3
