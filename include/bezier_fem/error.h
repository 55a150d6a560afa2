#pragma once

#include <stdexcept>

namespace bezier_fem
{
/**
 * What the user gave is wrong. what() is a single line that names the file, key or region, the offending value and
 * what is allowed; programs print it as it is (exit status 2), the node logs it.
 */
class InputError : public std::runtime_error
{
public:
  using std::runtime_error::runtime_error;
};

}  // namespace bezier_fem
