#define WIDTH 8
#define TABLE avx512_table
#define TABLE_NAME "avx512"
#include "kernels_impl.h"
