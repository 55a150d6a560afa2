#pragma once

// The yardstick: y = A x for a sparse matrix of 3x3 blocks in compressed rows, compiled for the machine that runs it.

/** Blocks of 9 doubles, row-major; vectors of 3 doubles a node. */
void plainProduct(int rows, const int* row_begin, const int* column, const double* blocks, const double* x, double* y);

/** Blocks of three columns x, y, z, 0; vectors of 4 doubles a node. */
void paddedProduct(int rows, const int* row_begin, const int* column, const double* blocks, const double* x, double* y);
