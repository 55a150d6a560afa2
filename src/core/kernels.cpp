#include "kernels.h"

#include <cstdlib>
#include <cstring>
#include <initializer_list>

namespace bezier_fem::kernels
{
extern const Table portable_table;
#ifdef BEZIER_FEM_X86
extern const Table avx2_table;
extern const Table avx512_table;
#endif

const Table* tableByName(const char* name)
{
  if (std::strcmp(name, "portable") == 0) return &portable_table;
#ifdef BEZIER_FEM_X86
  if (std::strcmp(name, "avx2") == 0 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
  {
    return &avx2_table;
  }
  if (std::strcmp(name, "avx512") == 0 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
      __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("fma"))
  {
    return &avx512_table;
  }
#endif
  return nullptr;
}

const Table& table()
{
  static const Table& best = [&]() -> const Table& {
    const char* wanted = std::getenv("BEZIER_FEM_ISA");
    if (wanted)
    {
      if (const Table* found = tableByName(wanted)) return *found;
    }
    for (const char* name : {"avx512", "avx2"})
    {
      if (const Table* found = tableByName(name)) return *found;
    }
    return portable_table;
  }();
  return best;
}

}  // namespace bezier_fem::kernels
