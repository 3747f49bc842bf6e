// (m, k) times (k, n) in float32, or a batch of such, called by code that torch's compiler makes.
//
// The kernel is oneDNN's, in torch's own library, which takes the rows of both sides as they lie.
// Transposed sides, of which gradients are made, are copied first.

#include <torch/csrc/inductor/aoti_torch/c/shim.h>

#include <cstdint>
#include <vector>

// Declared here as in torch's ATen/native/CPUBlas.h and fbgemm/Utils.h, which take seconds to read.
namespace at::native::cpublas {
void brgemm(int64_t m, int64_t n, int64_t k, int64_t left_step, int64_t right_step, int64_t step,
            bool add, const float* left, const float* right, float* out, bool packed);
}
namespace fbgemm {
template <typename T>
void transpose_simd(int64_t rows, int64_t columns, const T* from, int64_t from_step, T* to,
                    int64_t to_step);
extern template void transpose_simd<float>(int64_t, int64_t, const float*, int64_t, float*,
                                           int64_t);
}

namespace {

struct Matrix {
  const float* data;
  int64_t rows, columns, row_step, column_step;
};

// The same matrix with its columns side by side, in `scratch` if they are not.
Matrix side_by_side(const Matrix& from, std::vector<float>& scratch) {
  const auto [data, rows, columns, row_step, column_step] = from;
  if (column_step == 1 && row_step >= columns) return from;
  if (scratch.size() < static_cast<size_t>(rows * columns)) scratch.resize(rows * columns);
  if (row_step == 1 && column_step >= rows) {
    fbgemm::transpose_simd<float>(columns, rows, data, column_step, scratch.data(), columns);
  } else {
    for (int64_t i = 0; i < rows; ++i)
      for (int64_t j = 0; j < columns; ++j)
        scratch[i * columns + j] = data[i * row_step + j * column_step];
  }
  return {scratch.data(), rows, columns, columns, 1};
}

void multiply(const Matrix& left, const Matrix& right, float* out) {
  thread_local std::vector<float> left_scratch, right_scratch;
  const Matrix a = side_by_side(left, left_scratch), b = side_by_side(right, right_scratch);
  at::native::cpublas::brgemm(a.rows, b.columns, a.columns, a.row_step, b.row_step, b.columns,
                              false, a.data, b.data, out, false);
}

struct Batch {
  int64_t count, count_step;
  Matrix first;
  Matrix operator[](int64_t index) const {
    Matrix one = first;
    one.data += index * count_step;
    return one;
  }
};

Batch batch(AtenTensorHandle tensor) {
  int64_t dimensions, *sizes, *strides;
  void* data;
  if (aoti_torch_get_dim(tensor, &dimensions) || aoti_torch_get_sizes(tensor, &sizes) ||
      aoti_torch_get_strides(tensor, &strides) || aoti_torch_get_data_ptr(tensor, &data))
    throw 0;
  const int64_t d = dimensions - 2;
  return {d ? sizes[0] : 1,
          d ? strides[0] : 0,
          {static_cast<const float*>(data), sizes[d], sizes[d + 1], strides[d], strides[d + 1]}};
}

}  // namespace

extern "C" AOTITorchError aoti_torch_cpu_own_product(AtenTensorHandle left, AtenTensorHandle right,
                                           AtenTensorHandle* out) {
  try {
    const Batch a = batch(left), b = batch(right);
    const int64_t m = a.first.rows, n = b.first.columns;
    const int64_t sizes[] = {a.count, m, n}, strides[] = {m * n, n, 1};
    int64_t dimensions;
    void* data;
    if (aoti_torch_get_dim(left, &dimensions) ||
        aoti_torch_empty_strided(dimensions, sizes + 3 - dimensions, strides + 3 - dimensions,
                                 aoti_torch_dtype_float32(), aoti_torch_device_type_cpu(), 0,
                                 out) ||
        aoti_torch_get_data_ptr(*out, &data))
      return AOTI_TORCH_FAILURE;
    for (int64_t i = 0; i < a.count; ++i)
      multiply(a[i], b[i], static_cast<float*>(data) + i * m * n);
    return AOTI_TORCH_SUCCESS;
  } catch (...) {
    return AOTI_TORCH_FAILURE;
  }
}

// Whether this processor has what the kernel needs: 2 by 2 is tried.
extern "C" bool otc_dist_can_multiply() {
  const float left[] = {1, 2, 3, 4}, right[] = {1, 0, 0, 1};
  float out[4] = {};
  try {
    multiply({left, 2, 2, 2, 1}, {right, 2, 2, 1, 2}, out);
  } catch (...) {
    return false;
  }
  return out[0] == 1 && out[1] == 2 && out[2] == 3 && out[3] == 4;
}
