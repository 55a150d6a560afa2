#define WIDTH 4
#define PEAK peak_avx2
#define PEAK_NAME "avx2"
#include "peak_impl.h"
