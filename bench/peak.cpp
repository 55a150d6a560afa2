#include "peak.h"

#include <cstring>
#include <stdexcept>
#include <string>

extern const Peak peak_portable;
#ifdef BEZIER_FEM_X86
extern const Peak peak_avx2;
extern const Peak peak_avx512;
#endif

const Peak& peakOf(const char* name)
{
#ifdef BEZIER_FEM_X86
  for (const Peak* peak : {&peak_avx2, &peak_avx512})
  {
    if (std::strcmp(peak->name, name) == 0) return *peak;
  }
#endif
  if (std::strcmp(peak_portable.name, name) == 0) return peak_portable;
  throw std::runtime_error(std::string("no peak of ") + name);
}
