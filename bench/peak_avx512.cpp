#define WIDTH 8
#define PEAK peak_avx512
#define PEAK_NAME "avx512"
#include "peak_impl.h"
