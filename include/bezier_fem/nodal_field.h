#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <new>
#include <vector>

namespace bezier_fem
{
/** Allocates on cache-line boundaries, so that no 32- or 64-byte load of a kernel straddles two lines. */
template <class T>
struct CacheAlignedAllocator
{
  using value_type = T;
  static constexpr std::align_val_t ALIGNMENT{64};

  CacheAlignedAllocator() = default;
  template <class U>
  CacheAlignedAllocator(const CacheAlignedAllocator<U>& /*other*/)
  {
  }
  T* allocate(std::size_t n) { return static_cast<T*>(::operator new(n * sizeof(T), ALIGNMENT)); }
  void deallocate(T* p, std::size_t /*n*/) { ::operator delete(p, ALIGNMENT); }
  friend bool operator==(const CacheAlignedAllocator&, const CacheAlignedAllocator&) { return true; }
  friend bool operator!=(const CacheAlignedAllocator&, const CacheAlignedAllocator&) { return false; }
};

template <class T>
using AlignedVector = std::vector<T, CacheAlignedAllocator<T>>;

/**
 * One 3-vector a control point, stored as x, y, z, 0 so that a control point is one aligned 32-byte load. The fourth
 * number is zero and every operation on the whole field keeps it so.
 */
class NodalField
{
public:
  using Matrix = Eigen::Map<Eigen::Matrix4Xd, Eigen::Aligned32>;
  using ConstMatrix = Eigen::Map<const Eigen::Matrix4Xd, Eigen::Aligned32>;

  NodalField() = default;
  explicit NodalField(int size) : data_(4 * static_cast<std::size_t>(size), 0.0) {}

  int size() const { return static_cast<int>(data_.size() / 4); }
  double* data() { return data_.data(); }
  const double* data() const { return data_.data(); }

  Eigen::Map<Eigen::Vector3d> operator[](int i) { return Eigen::Map<Eigen::Vector3d>(data_.data() + 4 * i); }
  Eigen::Map<const Eigen::Vector3d> operator[](int i) const
  {
    return Eigen::Map<const Eigen::Vector3d>(data_.data() + 4 * i);
  }

  /** 4 x size, the last row zero. */
  Matrix matrix() { return Matrix(data_.data(), 4, size()); }
  ConstMatrix matrix() const { return ConstMatrix(data_.data(), 4, size()); }

  /** The same of nodes [first, first + count). */
  Matrix columns(int first, int count) { return Matrix(data_.data() + 4L * first, 4, count); }
  ConstMatrix columns(int first, int count) const { return ConstMatrix(data_.data() + 4L * first, 4, count); }

  void setZero() { matrix().setZero(); }

private:
  AlignedVector<double> data_;
};

}  // namespace bezier_fem
