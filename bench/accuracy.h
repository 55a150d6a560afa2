#pragma once

#include <nlohmann/json.hpp>
#include <string>

/** Studies of what the package computes against what it should; each gives its evidence as a table. */
namespace bezier_fem::bench
{
/** An array of rows: objects with the same keys in the same order; null where a row has nothing to say. */
using Table = nlohmann::ordered_json;

/** A line on stderr: what is being computed. */
void progress(const std::string& what);

/**
 * Error over mesh size: in L2 of a smooth made-up solution on irregular meshes, where the elements' orders must appear,
 * and at the tip of the clamped bar, whose edge holds both elements back.
 */
Table convergence();

/** The clamped bar's lowest ten frequencies, beside a dense element of other making and beam theory. */
Table frequencies();

/**
 * Near incompressibility: errors of linear and quadratic elements, the latter with either dilatation, as Poisson's
 * ratio goes to one half.
 */
Table locking();

/** What a free spin and a free swing keep of momentum, angular momentum and energy; a row every 0.1 s of each run. */
Table spin();

/** The cheapest mesh of each element whose static tip error is below 2 %, and what a step costs on it. */
Table equalAccuracy();

}  // namespace bezier_fem::bench
