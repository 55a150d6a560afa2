#include "plain_product.h"

void plainProduct(int rows, const int* row_begin, const int* column, const double* blocks, const double* x, double* y)
{
  for (int i = 0; i < rows; ++i)
  {
    double s0 = 0, s1 = 0, s2 = 0;
    for (int k = row_begin[i]; k < row_begin[i + 1]; ++k)
    {
      const double* b = blocks + 9L * k;
      const double* v = x + 3L * column[k];
      s0 += b[0] * v[0] + b[1] * v[1] + b[2] * v[2];
      s1 += b[3] * v[0] + b[4] * v[1] + b[5] * v[2];
      s2 += b[6] * v[0] + b[7] * v[1] + b[8] * v[2];
    }
    y[3L * i] = s0;
    y[3L * i + 1] = s1;
    y[3L * i + 2] = s2;
  }
}

void paddedProduct(int rows, const int* row_begin, const int* column, const double* blocks, const double* x, double* y)
{
  using Node = double __attribute__((vector_size(32)));
  for (int i = 0; i < rows; ++i)
  {
    Node a{}, b{}, c{};
    for (int k = row_begin[i]; k < row_begin[i + 1]; ++k)
    {
      const Node* block = reinterpret_cast<const Node*>(blocks + 12L * k);
      const double* v = x + 4L * column[k];
      a += v[0] * block[0];
      b += v[1] * block[1];
      c += v[2] * block[2];
    }
    *reinterpret_cast<Node*>(y + 4L * i) = a + b + c;
  }
}
