#include "sim/gltf_accessor.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>

namespace splatbus::sim {
namespace {

/// The bytes of an accessor, checked to lie within its buffer.
struct Rows {
  const unsigned char* data;
  std::size_t count, stride, component_bytes;
  int component_type;
  bool normalized;
};

[[noreturn]] void fail(int accessor, const std::string& what) {
  throw std::runtime_error(fmt::format("accessor {}: {}", accessor, what));
}

Rows rows_of(const tinygltf::Model& model, int index, int components) {
  const tinygltf::Accessor& accessor = item(model.accessors, index, "accessor");
  if (accessor.sparse.isSparse) fail(index, "sparse accessors are not supported");
  if (tinygltf::GetNumComponentsInType(static_cast<std::uint32_t>(accessor.type)) != components) {
    fail(index, fmt::format("its rows should have {} components", components));
  }
  const int component_bytes = tinygltf::GetComponentSizeInBytes(static_cast<std::uint32_t>(accessor.componentType));
  if (component_bytes <= 0) fail(index, fmt::format("component type {} is unknown", accessor.componentType));
  if (accessor.count > kMostRows)
    fail(index, fmt::format("{} rows, at most {} are allowed", accessor.count, kMostRows));

  const std::string where = fmt::format("accessor {}", index);
  const tinygltf::BufferView& view = within(
      where, [&]() -> const auto& { return item(model.bufferViews, accessor.bufferView, "buffer view"); });
  const tinygltf::Buffer& buffer = within(
      where, [&]() -> const auto& { return item(model.buffers, view.buffer, "buffer"); });
  const std::size_t row_bytes = static_cast<std::size_t>(component_bytes) * static_cast<std::size_t>(components);
  const std::size_t stride = view.byteStride != 0 ? view.byteStride : row_bytes;
  if (stride < row_bytes || stride > 4096) fail(index, fmt::format("a stride of {} bytes", stride));
  const std::size_t size = buffer.data.size();
  if (view.byteOffset > size || view.byteLength > size - view.byteOffset) {
    fail(index, fmt::format("its buffer view reaches out of the buffer of {} bytes", size));
  }
  const std::size_t needed = accessor.count == 0 ? 0 : stride * (accessor.count - 1) + row_bytes;
  if (accessor.byteOffset > view.byteLength || needed > view.byteLength - accessor.byteOffset) {
    fail(index, fmt::format("{} rows reach out of its buffer view of {} bytes", accessor.count, view.byteLength));
  }
  return {.data = buffer.data.data() + view.byteOffset + accessor.byteOffset,
          .count = accessor.count,
          .stride = stride,
          .component_bytes = static_cast<std::size_t>(component_bytes),
          .component_type = accessor.componentType,
          .normalized = accessor.normalized};
}

template <class T>
T load(const unsigned char* at) {
  T value;
  std::memcpy(&value, at, sizeof(T));
  return value;
}

}  // namespace

std::vector<float> read_floats(const tinygltf::Model& model, int accessor, int components) {
  const Rows rows = rows_of(model, accessor, components);
  if (rows.component_type != TINYGLTF_COMPONENT_TYPE_FLOAT && !rows.normalized) {
    fail(accessor, "its components should be floats or normalised integers");
  }
  const auto value_at = [&](const unsigned char* at) -> float {
    switch (rows.component_type) {
      case TINYGLTF_COMPONENT_TYPE_FLOAT:
        return load<float>(at);
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        return static_cast<float>(load<std::uint8_t>(at)) / 255;
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        return static_cast<float>(load<std::uint16_t>(at)) / 65535;
      case TINYGLTF_COMPONENT_TYPE_BYTE:
        return std::max(static_cast<float>(load<std::int8_t>(at)) / 127, -1.0F);
      case TINYGLTF_COMPONENT_TYPE_SHORT:
        return std::max(static_cast<float>(load<std::int16_t>(at)) / 32767, -1.0F);
      default:
        fail(accessor,
             fmt::format("component type {} is neither a float nor a normalised integer", rows.component_type));
    }
  };
  std::vector<float> values;
  values.reserve(rows.count * static_cast<std::size_t>(components));
  for (std::size_t row = 0; row < rows.count; ++row) {
    for (int c = 0; c < components; ++c) {
      const float value = value_at(rows.data + row * rows.stride + static_cast<std::size_t>(c) * rows.component_bytes);
      if (!std::isfinite(value)) fail(accessor, fmt::format("row {} is not finite", row));
      values.push_back(value);
    }
  }
  return values;
}

std::vector<std::uint32_t> read_indices(const tinygltf::Model& model, int accessor, std::size_t limit) {
  const Rows rows = rows_of(model, accessor, 1);
  const auto value_at = [&](const unsigned char* at) -> std::uint32_t {
    switch (rows.component_type) {
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        return load<std::uint8_t>(at);
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        return load<std::uint16_t>(at);
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
        return load<std::uint32_t>(at);
      default:
        fail(accessor, fmt::format("component type {} is not an unsigned integer", rows.component_type));
    }
  };
  std::vector<std::uint32_t> values;
  values.reserve(rows.count);
  for (std::size_t row = 0; row < rows.count; ++row) {
    const std::uint32_t value = value_at(rows.data + row * rows.stride);
    if (value >= limit) fail(accessor, fmt::format("index {} of {} vertices", value, limit));
    values.push_back(value);
  }
  return values;
}

}  // namespace splatbus::sim
