#include <Spectra/MatOp/SparseCholesky.h>
#include <Spectra/MatOp/SparseSymMatProd.h>
#include <Spectra/SymGEigsSolver.h>
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <unsupported/Eigen/MatrixFunctions>

#include "accuracy.h"
#include "core/assembled.h"
#include "core/bar.h"
#include "core/lagrange.h"

namespace bezier_fem::bench
{
namespace
{
using Eigen::VectorXd;
using test::RUBBER;

constexpr int MODES = 10;

struct Bar  // of square section, held at z = 0
{
  double width, length;  // m
};

std::vector<int> freeRows(const Eigen::Matrix3Xd& nodes)
{
  std::vector<int> rows;
  for (int i = 0; i < 3 * nodes.cols(); ++i)
  {
    if (nodes(2, i / 3) > 1e-9) rows.push_back(i);
  }
  return rows;
}

std::vector<double> hertz(const VectorXd& squares)
{
  std::vector<double> result;
  for (const double square : squares) result.push_back(std::sqrt(square) / (2 * M_PI));
  return result;
}

/** What a bar does in a mode. The mesh has no symmetry, so two bending modes of a square bar lie a little apart. */
enum Kind
{
  BENDING,
  TORSION,
  AXIAL
};
constexpr const char* KIND_NAMES[] = {"bending", "torsion", "axial"};

struct Mode
{
  double frequency;  // Hz
  Kind kind;
};

/** The lowest modes from the package's K and M: the largest mu = 1/omega^2 of M u = mu K u, by Lanczos. */
std::vector<Mode> packageModes(const Model& model)
{
  const std::vector<int> free = freeRows(model.rest.matrix().topRows<3>());
  const Rotations rest = restRotations(model);
  const Eigen::SparseMatrix<double> K = test::part(test::assembled(model, rest, 0, 1), free);
  const Eigen::SparseMatrix<double> M = test::part(test::assembled(model, rest, 1, 0), free);
  Spectra::SparseSymMatProd<double> product(M);
  Spectra::SparseCholesky<double> factor(K);
  Spectra::SymGEigsSolver<Spectra::SparseSymMatProd<double>, Spectra::SparseCholesky<double>,
                          Spectra::GEigsMode::Cholesky>
      solver(product, factor, MODES, 3 * MODES);
  solver.init();
  solver.compute(Spectra::SortRule::LargestAlge, 1000, 1e-12);
  if (solver.info() != Spectra::CompInfo::Successful) throw std::runtime_error("the eigenvalues did not converge");
  const std::vector<double> frequencies = hertz(solver.eigenvalues().cwiseInverse());

  // A mode's kind is the rigid motion that it has most of, each relative to its own inertia.
  Eigen::MatrixXd rigid = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(free.size()), 4);
  const Eigen::Vector3d centre = model.rest.matrix().topRows<3>().rowwise().mean();
  for (std::size_t k = 0; k < free.size(); ++k)
  {
    const int axis = free[k] % 3;
    const auto row = static_cast<Eigen::Index>(k);
    rigid(row, axis) = 1;
    const Eigen::Vector3d arm = model.rest[free[k] / 3] - centre;
    rigid(row, 3) = Eigen::Vector3d::UnitZ().cross(arm)[axis];
  }
  std::vector<Mode> modes;
  for (int k = 0; k < MODES; ++k)
  {
    const VectorXd share = (rigid.transpose() * (M * solver.eigenvectors().col(k))).array().square() /
                           (rigid.transpose() * M * rigid).diagonal().array();
    Eigen::Index most;
    share.maxCoeff(&most);
    modes.push_back({frequencies[k], most < 2 ? BENDING : most == 2 ? AXIAL : TORSION});
  }
  return modes;
}

std::vector<double> denseFrequencies(const test::LagrangeMesh& mesh,
                                     const std::vector<test::QuadraturePoint>& mass_rule)
{
  const test::LagrangeSystem system = test::lagrangeSystem(mesh, RUBBER, mass_rule);
  const std::vector<int> free = freeRows(mesh.nodes);
  // M with one point an element is singular, K is not.
  const VectorXd inverse = test::squaredFrequencies(system.M(free, free), system.K(free, free));
  return hertz(inverse.reverse().head(MODES).cwiseInverse());
}

/**
 * CalculiX's, with C3D4 or C3D10; none where there is no `ccx`. It integrates the mass with one or four points, which
 * is not exact: compare with a dense reference that does the same.
 */
std::vector<double> calculixFrequencies(const test::LagrangeMesh& mesh)
{
  if (std::system("command -v ccx > /dev/null") != 0) return {};
  std::string folder = (std::filesystem::temp_directory_path() / "bench_accuracy_XXXXXX").string();
  if (!mkdtemp(folder.data())) throw std::runtime_error("no temporary folder");
  const bool quadratic = mesh.elements.rows() == 10;
  // Its order of edges is 01 12 20 03 13 23.
  constexpr int ORDER[] = {0, 1, 2, 3, 4, 7, 5, 6, 8, 9};
  std::ofstream out(folder + "/bar.inp");
  out.precision(16);
  out << "*NODE\n";
  for (Eigen::Index i = 0; i < mesh.nodes.cols(); ++i)
  {
    out << i + 1 << ", " << mesh.nodes(0, i) << ", " << mesh.nodes(1, i) << ", " << mesh.nodes(2, i) << '\n';
  }
  out << "*ELEMENT, TYPE=" << (quadratic ? "C3D10" : "C3D4") << ", ELSET=BODY\n";
  for (Eigen::Index t = 0; t < mesh.elements.cols(); ++t)
  {
    out << t + 1;
    for (Eigen::Index k = 0; k < mesh.elements.rows(); ++k) out << ", " << mesh.elements(ORDER[k], t) + 1;
    out << '\n';
  }
  out << "*NSET, NSET=WALL\n";
  for (Eigen::Index i = 0; i < mesh.nodes.cols(); ++i)
  {
    if (mesh.nodes(2, i) < 1e-9) out << i + 1 << '\n';
  }
  out << "*MATERIAL, NAME=RUBBER\n*ELASTIC\n"
      << RUBBER.young << ", " << RUBBER.poisson << "\n*DENSITY\n"
      << RUBBER.density << "\n*SOLID SECTION, ELSET=BODY, MATERIAL=RUBBER\n*BOUNDARY\nWALL, 1, 3\n"
      << "*STEP\n*FREQUENCY\n"
      << MODES << "\n*END STEP\n";
  out.close();
  const int status = std::system(("cd '" + folder + "' && OMP_NUM_THREADS=1 ccx bar > ccx.log 2>&1").c_str());

  // Rows of five numbers: mode, eigenvalue, rad/s, 1/s, imaginary part; tables of participation follow.
  std::vector<double> result;
  std::ifstream in(folder + "/bar.dat");
  for (std::string line; static_cast<int>(result.size()) < MODES && std::getline(in, line);)
  {
    int mode;
    double square, omega, frequency;
    if (std::istringstream(line) >> mode >> square >> omega >> frequency) result.push_back(frequency);
  }
  if (status != 0 || static_cast<int>(result.size()) < MODES) throw std::runtime_error("ccx failed, see " + folder);
  std::filesystem::remove_all(folder);
  return result;
}

/** Roots of f above zero, found by steps of `step` and bisection. */
template <class F>
std::vector<double> roots(const F& f, double step, int count)
{
  std::vector<double> result;
  double low = step;
  for (double f_low = f(low); static_cast<int>(result.size()) < count; low += step)
  {
    const double f_next = f(low + step);
    if (f_low * f_next < 0)
    {
      double a = low, b = low + step;
      for (int k = 0; k < 60; ++k)
      {
        const double middle = (a + b) / 2;
        (f(middle) * f_low > 0 ? a : b) = middle;
      }
      result.push_back((a + b) / 2);
    }
    f_low = f_next;
  }
  return result;
}

/**
 * Bending of a clamped beam with shear and rotary inertia (Timoshenko 1921; shear coefficient of a rectangle from
 * Cowper 1966). With deflection w, turn p, moment m and shear force q: w' = p + q/(k G A), p' = m/(E I),
 * m' = -q - rho I omega^2 p, q' = -rho A omega^2 w; w = p = 0 at the foot, m = q = 0 at the tip. Hz.
 */
std::vector<double> timoshenko(const Bar& bar)
{
  const double A = bar.width * bar.width, I = A * A / 12, rho = RUBBER.density;
  const double shear = 10 * (1 + RUBBER.poisson) / (12 + 11 * RUBBER.poisson) * lameMu(RUBBER) * A;
  // Moments in units of the bending stiffness, forces in those of the shear stiffness: numbers near one.
  const double EI = RUBBER.young * I;
  const auto determinant = [&](double frequency) {
    const double omega2 = std::pow(2 * M_PI * frequency, 2);
    Eigen::Matrix4d slope = Eigen::Matrix4d::Zero();
    slope(0, 1) = slope(0, 3) = slope(1, 2) = 1;
    slope(2, 3) = -shear / EI;
    slope(2, 1) = -rho * I * omega2 / EI;
    slope(3, 0) = -rho * A * omega2 / shear;
    const Eigen::Matrix4d along = (slope * bar.length).exp();
    return along.bottomRightCorner<2, 2>().determinant();
  };
  return roots(determinant, 0.002 * std::sqrt(RUBBER.young / rho) / bar.length, MODES);
}

/** The same without shear and rotary inertia: cos(b) cosh(b) = -1, omega = b^2 sqrt(E I/(rho A L^4)). Hz. */
std::vector<double> eulerBernoulli(const Bar& bar)
{
  std::vector<double> result;
  // Divided by cosh, which grows out of bounds.
  for (const double b : roots([](double x) { return std::cos(x) + 1 / std::cosh(x); }, 0.1, MODES))
  {
    const double radius = bar.width / std::sqrt(12.0);
    result.push_back(b * b / (2 * M_PI) * radius / (bar.length * bar.length) *
                     std::sqrt(RUBBER.young / RUBBER.density));
  }
  return result;
}

/** Waves of speed c in a rod held at one end: odd quarters. Hz. */
std::vector<double> quarterWaves(const Bar& bar, double c)
{
  std::vector<double> result(MODES);
  for (int k = 0; k < MODES; ++k) result[k] = (2 * k + 1) * c / (4 * bar.length);
  return result;
}

void addBar(const Bar& bar, const Eigen::Vector3i& cells, Element element, bool dense, Table& table)
{
  const TetMesh mesh = test::kuhnBox(cells, {bar.width, bar.width, bar.length});
  const Model model = test::boxModel(mesh, element);
  progress("frequencies, " + std::to_string(model.num_tets) + " " + test::name(element) + " tets");
  const test::LagrangeMesh nodal = test::lagrangeMesh(mesh, element);
  std::vector<double> reference, like_calculix;
  if (dense)
  {
    reference = denseFrequencies(nodal, test::tetRule(4));
    like_calculix = denseFrequencies(nodal, test::shortTetRule(element == Element::LINEAR ? 1 : 4));
  }
  const std::vector<double> calculix = calculixFrequencies(nodal);

  // Torsion of a square after Saint-Venant: stiffness 0.140577 G a^4 against the inertia rho a^4/6.
  const std::vector<double> theory[] = {timoshenko(bar),
                                        quarterWaves(bar, std::sqrt(6 * 0.140577 * lameMu(RUBBER) / RUBBER.density)),
                                        quarterWaves(bar, std::sqrt(RUBBER.young / RUBBER.density))};
  const std::vector<double> slender = eulerBernoulli(bar);
  const std::vector<Mode> modes = packageModes(model);
  std::map<Kind, int> seen;
  for (int k = 0; k < MODES; ++k)
  {
    const auto& [frequency, kind] = modes[k];
    const int n = kind == BENDING ? seen[kind] / 2 : seen[kind];  // bending comes in pairs
    ++seen[kind];
    Table row{{"bar", std::to_string(bar.width).substr(0, 3) + " x " + std::to_string(bar.length).substr(0, 1) + " m"},
              {"element", test::name(element)},
              {"tets", model.num_tets},
              {"mode", k + 1},
              {"kind", KIND_NAMES[kind]},
              {"frequency", frequency},
              {"dense_reference", nullptr},
              {"dense_like_calculix", nullptr},
              {"calculix", nullptr},
              {"beam_theory", theory[kind][n]},
              {"euler_bernoulli", nullptr}};
    if (dense)
    {
      row["dense_reference"] = reference[k];
      row["dense_like_calculix"] = like_calculix[k];
    }
    if (!calculix.empty()) row["calculix"] = calculix[k];
    if (kind == BENDING) row["euler_bernoulli"] = slender[n];
    table.push_back(row);
  }
}
}  // namespace

Table frequencies()
{
  Table table = Table::array();
  const Bar stout{0.4, 1}, slender{0.1, 1};
  addBar(stout, {2, 2, 5}, Element::QUADRATIC, true, table);
  addBar(stout, {4, 4, 10}, Element::QUADRATIC, false, table);
  addBar(stout, {6, 6, 15}, Element::QUADRATIC, false, table);
  addBar(stout, {4, 4, 10}, Element::LINEAR, true, table);
  addBar(slender, {1, 1, 10}, Element::QUADRATIC, true, table);
  addBar(slender, {3, 3, 30}, Element::QUADRATIC, false, table);
  return table;
}

}  // namespace bezier_fem::bench
