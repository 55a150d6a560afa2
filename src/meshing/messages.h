// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <vector>

namespace make_model
{
/** As std::sprintf() writes it, cut off after 1023 characters. */
__attribute__((format(printf, 1, 2))) std::string text(const char* format, ...);

/** What the run is busy with, on a terminal only. */
class Progress
{
public:
  Progress();
  ~Progress() { show(""); }
  void show(const std::string& stage) const;

private:
  const bool on_terminal_;
};

/** Kept until the mesh is written: a refused surface gets one line and nothing beside it. */
struct Remarks
{
  std::vector<std::string> repairs, warnings;
};

}  // namespace make_model
