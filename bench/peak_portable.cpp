#define WIDTH 2
#define PEAK peak_portable
#define PEAK_NAME "portable"
#include "peak_impl.h"
