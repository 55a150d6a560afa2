#pragma once

#include <string>
#include <vector>

namespace bezier_fem
{
/**
 * Writes a scene file with overrides put in. Keys keep their order, comments are not kept. Paths that the scene gives
 * relative to itself are written relative to the new file.
 * @param overrides  as loadScene() takes them
 * @param comments   lines for the head of the file, without #
 * @throws InputError if the scene with the overrides is wrong, or the file cannot be written
 */
void writeScene(const std::string& from, const std::vector<std::string>& overrides, const std::string& to,
                const std::vector<std::string>& comments);

}  // namespace bezier_fem
