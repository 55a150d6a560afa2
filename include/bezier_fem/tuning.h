#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "bezier_fem/scene.h"
#include "bezier_fem/sizing.h"
#include "bezier_fem/variant.h"

/** The cheapest numerics that are accurate enough for a scene. */
namespace bezier_fem
{
/** What the wanted error is of. Definitions: VariantErrors. */
enum class Quantity
{
  TIP,    // way of the probe that moves most, root mean square over time
  FIELD,  // displacement of the whole body, root mean square
  MAX,    // the largest displacement error anywhere, at any time
  STRESS  // von Mises stress at the probes at the end
};

double errorOf(const VariantErrors& errors, Quantity quantity);

/** What is tuned of a scene; the rest stays. */
struct Numerics
{
  Element element;
  std::optional<double> cell_size;    // m; of surfaces
  std::optional<std::string> sizing;  // path
  int refine;
  double time_step;       // s
  Integrator integrator;  // statics leave both as they are
  double tolerance;
};

const char* nameOf(Element element);        // as in the scene file
const char* nameOf(Integrator integrator);  // as in the scene file
Numerics numericsOf(const Scene& scene);
Scene with(Scene scene, const Numerics& numerics);
/** As overrides of the scene file, "KEY=VALUE"; but for the sizing, whose path is relative to the scene. */
std::vector<std::string> overridesOf(const Numerics& numerics, bool statics);

struct TuneRequest
{
  double error = 0.02;  // relative
  Quantity quantity = Quantity::TIP;
  std::optional<double> budget_ms;  // largest cost, see Trial::cost
  /** To be set for meshes that are finer only where that pays; for surfaces. */
  struct Local
  {
    std::string file;                                                           // absolute path of the sizing to write
    std::function<std::vector<SizePoint>(const Scene&, const RunPlan&)> sizes;  // balancedSizes() but for tests
  };
  std::optional<Local> local;
  RunPlan plan;
  double seconds = 90;  // wall clock; no run is begun that would go on for longer, as far as can be foreseen
};

/** A model that was run. */
struct Trial
{
  enum class Role
  {
    STEP,  // on the scene's own mesh, to see what time steps and tolerances do
    MESH,  // at the reference's time step, to see what the mesh does; the finest one is the reference
    CANDIDATE,
    LOCAL  // as the best candidate, with a graded mesh
  };
  Role role;
  Numerics numerics;
  RunStatus status;
  std::string reason;
  int tets, nodes;
  double ms_per_step;
  /** Wall clock in ms: of a static solve, or of as much time as one time_step of the scene as it was given. */
  double cost;
  /**
   * What its error may be: of a candidate the difference from the reference and the reference's own error; of the
   * others what their axis alone contributes. NaN where nothing can be said.
   */
  double error;
};

struct Tuning
{
  Numerics chosen;
  double error = VariantErrors::NOTHING;            // of the chosen, as Trial::error
  double reference_error = VariantErrors::NOTHING;  // of the reference, contained in it
  Trial reference;
  double cost = 0;
  bool accurate = false, affordable = false;  // error <= wanted; cost <= budget, or no budget
  std::vector<Trial> trials;                  // in the order of the runs
  std::string why;                            // a sentence or two
};

using Runner = std::function<Recording(const Scene&, const RunPlan&, const BodyPoints*)>;

/**
 * Tries models from the cheapest up. The grid: both elements; cell sizes from twice the scene's down in steps of
 * 2^(1/4) (surfaces) or refine from 0 to 4 (files of tetrahedra); time steps from twice the scene's down in steps of 2;
 * tolerances of 1e-1 to 1e-3; implicit_euler and auto (a scene with the explicit integrator keeps it).
 *
 * The reference is quadratic. Its own error has three parts, added: of the mesh, from the quadratic meshes in a row
 * that end with it; of the time step, from the steps in a row that end with it, on the scene's own mesh; of the
 * tolerance, there too, against one of 1e-6 (statics: 1e-8). For a row the estimate is Roache's grid convergence index
 * (Perspective: a method for uniform reporting of grid refinement studies, J. Fluids Eng. 116, 1994): F d/(r^p - 1), d
 * the difference of the last two, r = 2 the ratio of their sizes, p the order seen with the last three, held between
 * 0.5 and 2 (steps: the integrator's order), F = 1.25; with two only F = 3 and p = 1. Meshes of a surface differ in
 * their boundaries and in what a region selects as well, which does not fall smoothly: of them the estimate is at least
 * 2 times the difference of neighbours in cell size, the last pair's or the one before.
 *
 * A candidate counts as accurate when its difference from the reference plus the reference's own error is at most what
 * is wanted. Candidates are run in the order of the cost foreseen, those left out whose mesh and time step have one and
 * a half times the wanted error between them, until nothing cheaper than the best is left. Half of the time goes to the
 * reference; it is fine enough once its own error is a quarter of what is wanted.
 *
 * With TuneRequest::local the best candidate is then tried with graded meshes, of a quarter as many elements and up,
 * until one is accurate; it is taken if it is cheaper.
 *
 * @param run       runs one model; record() but for tests
 * @param progress  told what is being run; may be empty
 * @throws InputError if the scene as it is cannot be run, the quantity says nothing of it, or a local refinement is
 *         wanted of a file of tetrahedra
 */
Tuning tune(const Scene& scene, const TuneRequest& request, const Runner& run,
            const std::function<void(const std::string&)>& progress);

}  // namespace bezier_fem
