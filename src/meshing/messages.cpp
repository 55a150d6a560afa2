// SPDX-License-Identifier: GPL-3.0-or-later
#include "messages.h"

#include <unistd.h>

#include <array>
#include <cstdarg>
#include <cstdio>

namespace make_model
{
std::string text(const char* format, ...)
{
  std::array<char, 1024> buffer;
  va_list arguments;
  va_start(arguments, format);
  std::vsnprintf(buffer.data(), buffer.size(), format, arguments);
  va_end(arguments);
  return buffer.data();
}

Progress::Progress() : on_terminal_(isatty(STDERR_FILENO) != 0)
{
}

void Progress::show(const std::string& stage) const
{
  if (on_terminal_) std::fprintf(stderr, "\r\033[K%s", stage.c_str());
}

}  // namespace make_model
