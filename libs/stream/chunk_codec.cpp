#include <draco/compression/decode.h>
#include <draco/compression/expert_encode.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <limits>
#include <utility>

#include "stream/bytes.h"
#include "stream/codecs.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kHeaderBytes = 11;  // "DRACO", version 2.3, point cloud, sequential, flags

// Neighbours on the curve predict where a Gaussian is and what it looks like, but not how it is turned.
bool predicts(Attribute attribute) {
  return attribute != Attribute::Rotation && attribute != Attribute::Residual && attribute != Attribute::ShRest &&
         attribute != Attribute::Opacity && attribute != Attribute::LogScale;
}

int add_attribute(draco::PointCloud& cloud, int channels) {
  draco::GeometryAttribute attribute;
  attribute.Init(draco::GeometryAttribute::GENERIC, nullptr, static_cast<std::int8_t>(channels), draco::DT_INT32, false,
                 static_cast<std::int64_t>(sizeof(std::int32_t)) * channels, 0);
  return cloud.AddAttribute(attribute, true, cloud.num_points());
}

void put_varint(Bytes& out, std::uint32_t value) {
  while (value >= 0x80) {
    out.push_back(static_cast<std::uint8_t>(value | 0x80));
    value >>= 7;
  }
  out.push_back(static_cast<std::uint8_t>(value));
}

// What Draco 2.3 writes before the values of such a point cloud: header, point count, one attribute decoder that has
// all attributes, and for each its type, data type, channels, normalized flag and id.
Bytes expected_declarations(const StreamLayout& layout, std::size_t count) {
  Bytes out{'D', 'R', 'A', 'C', 'O', 2, 3, draco::POINT_CLOUD, draco::POINT_CLOUD_SEQUENTIAL_ENCODING, 0, 0};
  for (int i = 0; i < 4; ++i) out.push_back(static_cast<std::uint8_t>(count >> (8 * i)));
  out.push_back(1);
  const auto attributes = static_cast<std::uint32_t>(layout.attributes().size()) + 1;
  put_varint(out, attributes);
  for (std::uint32_t i = 0; i < attributes; ++i) {
    const int channels = i + 1 < attributes ? layout.attributes()[i].channels : 1;
    out.insert(out.end(), {draco::GeometryAttribute::GENERIC, draco::DT_INT32, static_cast<std::uint8_t>(channels), 0});
    put_varint(out, i);
  }
  for (std::uint32_t i = 0; i < attributes; ++i) out.push_back(draco::SEQUENTIAL_ATTRIBUTE_ENCODER_INTEGER);
  return out;
}

// Spreads the lowest 21 bits of v so that two zero bits follow each.
std::uint64_t spread(std::uint64_t v) {
  v &= 0x1FFFFF;
  v = (v | v << 32) & 0x1F00000000FFFFULL;
  v = (v | v << 16) & 0x1F0000FF0000FFULL;
  v = (v | v << 8) & 0x100F00F00F00F00FULL;
  v = (v | v << 4) & 0x10C30C30C30C30C3ULL;
  v = (v | v << 2) & 0x1249249249249249ULL;
  return v;
}

void read_attribute(const draco::PointCloud& cloud, int id, int channels, std::size_t count,
                    std::span<std::vector<std::int32_t>> planes) {
  const draco::PointAttribute* attribute = cloud.attribute(id);
  if (!attribute || attribute->data_type() != draco::DT_INT32 || attribute->num_components() != channels ||
      attribute->size() != count || !attribute->is_mapping_identity()) {
    throw StreamError(fmt::format("Page: Draco attribute {} is not {} x {} integers", id, count, channels));
  }
  const auto* values = reinterpret_cast<const std::int32_t*>(attribute->GetAddress(draco::AttributeValueIndex(0)));
  if (attribute->byte_stride() != static_cast<std::int64_t>(sizeof(std::int32_t)) * channels) {
    throw StreamError("Page: Draco attribute with gaps");
  }
  for (int c = 0; c < channels; ++c) {
    for (std::size_t i = 0; i < count; ++i) planes[c][i] = values[i * static_cast<std::size_t>(channels) + c];
  }
}

}  // namespace

Bytes encode_chunk(const QuantizedGaussians& gaussians, const StreamLayout& layout) {
  const std::size_t count = gaussians.count();
  assert(count > 0 && count <= kMaxChunkGaussians);
  draco::PointCloud cloud;
  cloud.set_num_points(static_cast<std::uint32_t>(count));
  const auto fill = [&](int id, int channels, auto&& get) {
    auto* values = reinterpret_cast<std::int32_t*>(cloud.attribute(id)->GetAddress(draco::AttributeValueIndex(0)));
    for (int c = 0; c < channels; ++c) {
      for (std::size_t i = 0; i < count; ++i) values[i * static_cast<std::size_t>(channels) + c] = get(c, i);
    }
  };
  std::vector<std::pair<int, bool>> prediction;
  for (const AttributeChannels& a : layout.attributes()) {
    const int id = add_attribute(cloud, a.channels);
    fill(id, a.channels, [&](int c, std::size_t i) { return gaussians.channels[a.first + c][i]; });
    prediction.emplace_back(id, predicts(a.attribute));
  }
  const int objects = add_attribute(cloud, 1);
  fill(objects, 1, [&](int, std::size_t i) { return static_cast<std::int32_t>(gaussians.object_id[i]); });

  draco::ExpertEncoder encoder(cloud);
  encoder.SetEncodingMethod(draco::POINT_CLOUD_SEQUENTIAL_ENCODING);
  encoder.SetSpeedOptions(0, 0);
  for (const auto& [id, predict] : prediction) {
    const draco::Status status =
        encoder.SetAttributePredictionScheme(id, predict ? draco::PREDICTION_DIFFERENCE : draco::PREDICTION_NONE);
    if (!status.ok()) throw StreamError("Draco: " + status.error_msg_string());
  }
  draco::EncoderBuffer buffer;
  const draco::Status status = encoder.EncodeToBuffer(&buffer);
  if (!status.ok()) throw StreamError("Draco: " + status.error_msg_string());
  return {buffer.data(), buffer.data() + buffer.size()};
}

QuantizedGaussians decode_chunk(std::span<const std::uint8_t> payload, const StreamLayout& layout, std::size_t count) {
  if (count < 1 || count > kMaxChunkGaussians) {
    throw StreamError(fmt::format("Page: {} Gaussians in one chunk, 1 to {} are allowed", count, kMaxChunkGaussians));
  }
  const Bytes expected = expected_declarations(layout, count);
  static_assert(kHeaderBytes == 11);
  if (payload.size() < expected.size() || !std::equal(expected.begin(), expected.end(), payload.begin())) {
    throw StreamError(
        fmt::format("Page: payload of {} bytes does not declare {} Gaussians of this layout", payload.size(), count));
  }
  draco::DecoderBuffer buffer;
  buffer.Init(reinterpret_cast<const char*>(payload.data()), payload.size());
  draco::Decoder decoder;
  auto decoded = decoder.DecodePointCloudFromBuffer(&buffer);
  if (!decoded.ok()) throw StreamError("Page: Draco: " + decoded.status().error_msg_string());
  const draco::PointCloud& cloud = *decoded.value();
  if (cloud.num_points() != count || cloud.num_attributes() != static_cast<int>(layout.attributes().size()) + 1) {
    throw StreamError("Page: Draco decoded something other than what was declared");
  }
  QuantizedGaussians out(layout, count);
  int id = 0;
  for (const AttributeChannels& a : layout.attributes()) {
    const auto planes =
        std::span(out.channels).subspan(static_cast<std::size_t>(a.first), static_cast<std::size_t>(a.channels));
    read_attribute(cloud, id++, a.channels, count, planes);
    for (const auto& plane : planes) {
      const auto [low, high] = std::minmax_element(plane.begin(), plane.end());
      if (*low < a.minimum || *high > a.maximum) {
        throw StreamError(
            fmt::format("Page: {} outside [{}, {}]", wire::EnumNameAttribute(a.attribute), a.minimum, a.maximum));
      }
    }
  }
  std::vector<std::vector<std::int32_t>> objects(1, std::vector<std::int32_t>(count));
  read_attribute(cloud, id, 1, count, objects);
  for (std::size_t i = 0; i < count; ++i) out.object_id[i] = static_cast<std::uint32_t>(objects[0][i]);
  return out;
}

std::vector<std::uint32_t> morton_order(const QuantizedGaussians& gaussians, const StreamLayout& layout,
                                        std::span<const std::uint32_t> columns) {
  const int first = layout.at(Attribute::Mean).first;
  std::array<std::int32_t, 3> low{};
  std::int64_t extent = 1;
  for (int c = 0; c < 3 && !columns.empty(); ++c) {
    std::int32_t high = low[c] = gaussians.channels[first + c][columns[0]];
    for (const std::uint32_t i : columns) {
      low[c] = std::min(low[c], gaussians.channels[first + c][i]);
      high = std::max(high, gaussians.channels[first + c][i]);
    }
    extent = std::max(extent, std::int64_t{high} - low[c]);
  }
  int shift = 0;
  while ((extent >> shift) >= (1 << 21)) ++shift;
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keyed;
  keyed.reserve(columns.size());
  for (const std::uint32_t i : columns) {
    std::uint64_t key = 0;
    for (int c = 0; c < 3; ++c) {
      const auto offset = static_cast<std::uint64_t>(std::int64_t{gaussians.channels[first + c][i]} - low[c]);
      key |= spread(offset >> shift) << c;
    }
    keyed.emplace_back(key, i);
  }
  std::sort(keyed.begin(), keyed.end());
  std::vector<std::uint32_t> order;
  order.reserve(keyed.size());
  for (const auto& [key, column] : keyed) order.push_back(column);
  return order;
}

}  // namespace splatbus::stream
