// SPDX-License-Identifier: GPL-3.0-or-later
#include "msh_writer.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <stdexcept>

namespace make_model
{
namespace
{
void append(std::string& text, double value)
{
  char digits[32];
  text.append(digits, std::to_chars(digits, digits + sizeof(digits), value).ptr);  // shortest that reads back the same
}

std::string mshText(const Tets& mesh, const Topology& topology)
{
  std::string text = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n" + std::to_string(topology.bodies) + "\n";
  for (int body = 1; body <= topology.bodies; ++body)
    text += "3 " + std::to_string(body) + " \"body" + (topology.bodies > 1 ? "_" + std::to_string(body) : "") + "\"\n";
  text += "$EndPhysicalNames\n$Nodes\n" + std::to_string(mesh.points.cols()) + "\n";
  for (Eigen::Index i = 0; i < mesh.points.cols(); ++i)
  {
    text += std::to_string(i + 1);
    for (const double x : mesh.points.col(i))
    {
      text += ' ';
      append(text, x);
    }
    text += '\n';
  }
  text += "$EndNodes\n$Elements\n" + std::to_string(mesh.tets.cols()) + "\n";
  for (Eigen::Index t = 0; t < mesh.tets.cols(); ++t)
  {
    const std::string body = std::to_string(topology.body[static_cast<std::size_t>(t)] + 1);
    text += std::to_string(t + 1) + " 4 2 " + body + " " + body;  // type 4: four nodes; two tags: physical, elementary
    for (const int corner : mesh.tets.col(t)) text += " " + std::to_string(corner + 1);
    text += '\n';
  }
  return text + "$EndElements\n";
}

}  // namespace

void writeMsh(const std::string& path, const Tets& mesh, const Topology& topology)
{
  const std::string text = mshText(mesh, topology);
  const std::string temporary = path + "." + std::to_string(getpid()) + ".part";
  const auto fail = [&] {
    const int reason = errno;
    std::remove(temporary.c_str());
    throw std::runtime_error(path + ": cannot be written: " + std::strerror(reason));
  };
  std::FILE* file = std::fopen(temporary.c_str(), "wb");
  if (!file) fail();
  const bool written = std::fwrite(text.data(), 1, text.size(), file) == text.size() && std::fflush(file) == 0 &&
                       fsync(fileno(file)) == 0;
  if (std::fclose(file) != 0 || !written) fail();
  if (std::rename(temporary.c_str(), path.c_str()) != 0) fail();
}

}  // namespace make_model
