#define WIDTH 2
#define TABLE portable_table
#define TABLE_NAME "portable"
#include "kernels_impl.h"
