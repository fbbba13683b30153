#include <thrust/sort.h>

#include "algorithms.h"
#include "device/buffer.h"
#include "device/parallel.h"

namespace splatbus::device {

namespace {

struct Reciprocal {
  float* out;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const { out[i] = 1.0F / (1.0F + static_cast<float>(i)); }
};

struct CountOdd {
  const std::uint32_t* values;
  std::uint32_t* odd;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    if (values[i] % 2 == 1) atomic_add(odd, 1U);
  }
};

}  // namespace

std::vector<float> reciprocals(StreamView stream, std::uint32_t count) {
  Buffer<float> out(stream, count);
  for_each_index(stream, count, Reciprocal{out.data()});
  return out.to_host();
}

std::vector<std::uint32_t> sorted(StreamView stream, const std::vector<std::uint32_t>& values) {
  Buffer<std::uint32_t> keys(stream);
  keys.assign(values);
  with_policy(stream, [&](auto&& policy) { thrust::sort(policy, keys.data(), keys.data() + keys.size()); });
  return keys.to_host();
}

std::uint32_t count_odd(StreamView stream, const std::vector<std::uint32_t>& values) {
  Buffer<std::uint32_t> in(stream);
  Buffer<std::uint32_t> odd(stream, 1);
  in.assign(values);
  odd.clear();
  for_each_index(stream, static_cast<std::uint32_t>(values.size()), CountOdd{in.data(), odd.data()});
  return odd.to_host().front();
}

}  // namespace splatbus::device
