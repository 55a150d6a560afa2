#define WIDTH 4
#define TABLE avx2_table
#define TABLE_NAME "avx2"
#include "kernels_impl.h"
