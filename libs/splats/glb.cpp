#include "splats/glb.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

namespace splatbus::splats {

namespace {

static_assert(std::endian::native == std::endian::little, "numbers are written as they lie in memory");

constexpr std::uint32_t kMagic = 0x46546C67, kJsonChunk = 0x4E4F534A, kBinaryChunk = 0x004E4942;
constexpr int kFloat = 5126, kUnsignedShort = 5123, kArrayBuffer = 34962;

/// An accessor of the primitive and its part of the binary chunk, tightly packed.
struct Attribute {
  std::string name;
  const char* type;
  int component_type = kFloat;
  std::size_t bytes = 0;   // of one Gaussian, a multiple of 4
  std::size_t offset = 0;  // in the chunk
};

std::vector<Attribute> attributes_of(const BakedModel& model) {
  const std::string prefix = "KHR_gaussian_splatting:";
  std::vector<Attribute> all = {{"POSITION", "VEC3", kFloat, 12},
                                {"COLOR_0", "VEC4", kUnsignedShort, 8},
                                {prefix + "ROTATION", "VEC4", kFloat, 16},
                                {prefix + "SCALE", "VEC3", kFloat, 12},
                                {prefix + "OPACITY", "SCALAR", kFloat, 4}};
  for (int degree = 0; degree <= model.sh_degree(); ++degree) {
    for (int k = 0; k <= 2 * degree; ++k) {
      all.push_back({fmt::format("{}SH_DEGREE_{}_COEF_{}", prefix, degree, k), "VEC3", kFloat, 12});
    }
  }
  std::size_t offset = 0;
  for (Attribute& attribute : all) {
    attribute.offset = offset;
    offset += attribute.bytes * model.count();
  }
  return all;
}

/// COLOR_0 is linear.
std::array<std::uint16_t, 4> point_color(const Splat& splat, float opacity) {
  std::array<std::uint16_t, 4> color{};
  const auto quantised = [](float value) { return static_cast<std::uint16_t>(std::lround(value * 65535)); };
  for (int c = 0; c < 3; ++c) {
    const float display = std::clamp(0.5F + kShC0 * splat.sh[0][c], 0.0F, 1.0F);
    color[static_cast<std::size_t>(c)] = quantised(linear_from_srgb(display));
  }
  color[3] = quantised(opacity);
  return color;
}

struct Content {
  std::vector<char> binary;
  glm::vec3 low{std::numeric_limits<float>::infinity()}, high{-std::numeric_limits<float>::infinity()};  ///< of means
};

Content fill(const BakedModel& model, const std::vector<Attribute>& attributes, bool turn) {
  Content content;
  content.binary.resize(attributes.back().offset + attributes.back().bytes * model.count());
  for (std::size_t i = 0; i < model.count(); ++i) {
    const Splat splat = turn ? turned(model[i]) : model[i];
    auto attribute = attributes.begin();
    const auto put = [&](const auto& value) {
      std::memcpy(content.binary.data() + attribute->offset + i * attribute->bytes, &value, sizeof value);
      ++attribute;
    };
    const float opacity = 1 / (1 + std::exp(-splat.opacity_logit));
    const glm::quat& q = splat.rotation;
    put(splat.mean);
    put(point_color(splat, opacity));
    put(std::array<float, 4>{q.x, q.y, q.z, q.w});
    put(glm::exp(splat.log_scale));
    put(opacity);
    for (std::size_t k = 0; attribute != attributes.end(); ++k) put(splat.sh[k]);
    content.low = glm::min(content.low, splat.mean);
    content.high = glm::max(content.high, splat.mean);
  }
  return content;
}

std::string json_of(const std::vector<Attribute>& attributes, std::size_t count, const Content& content) {
  const auto vector = [](const glm::vec3& v) {  // a float's nine digits, read as a double, may be another float
    return fmt::format("[{},{},{}]", double{v.x}, double{v.y}, double{v.z});
  };
  std::string names, accessors, views;
  for (std::size_t i = 0; i < attributes.size(); ++i) {
    const Attribute& attribute = attributes[i];
    const char* comma = i == 0 ? "" : ",";
    names += fmt::format(R"({}"{}":{})", comma, attribute.name, i);
    accessors += fmt::format(
        R"({}{{"bufferView":{},"componentType":{},"count":{},"type":"{}"{}{}}})", comma, i, attribute.component_type,
        count, attribute.type, attribute.component_type == kFloat ? "" : R"(,"normalized":true)",
        i == 0 ? fmt::format(R"(,"min":{},"max":{})", vector(content.low), vector(content.high)) : "");
    views += fmt::format(R"({}{{"buffer":0,"byteOffset":{},"byteLength":{},"target":{}}})", comma, attribute.offset,
                         attribute.bytes * count, kArrayBuffer);
  }
  return fmt::format(
      R"({{"asset":{{"version":"2.0","generator":"splatbus"}},"extensionsUsed":["KHR_gaussian_splatting"],)"
      R"("scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],)"
      R"("meshes":[{{"primitives":[{{"mode":0,"attributes":{{{}}},"extensions":{{"KHR_gaussian_splatting":)"
      R"({{"kernel":"ellipse","colorSpace":"srgb_rec709_display"}}}}}}]}}],)"
      R"("accessors":[{}],"bufferViews":[{}],"buffers":[{{"byteLength":{}}}]}})",
      names, accessors, views, content.binary.size());
}

}  // namespace

void write_glb(std::ostream& stream, const BakedModel& model, const WriteOptions& options) {
  if (model.count() == 0) throw std::runtime_error("a .glb file cannot hold a model without Gaussians");
  const std::vector<Attribute> attributes = attributes_of(model);
  const std::size_t bytes = attributes.back().offset + attributes.back().bytes * model.count();
  constexpr std::size_t kRoomForJson = std::size_t{64} << 10;
  if (bytes > std::numeric_limits<std::uint32_t>::max() - kRoomForJson) {
    throw std::runtime_error(fmt::format("a .glb file cannot hold {} Gaussians: 4 GiB at most", model.count()));
  }
  const Content content = fill(model, attributes, options.axes == Axes::Turn);
  std::string json = json_of(attributes, model.count(), content);
  json.resize((json.size() + 3) / 4 * 4, ' ');
  const auto put = [&stream](std::initializer_list<std::size_t> numbers) {
    for (const std::size_t number : numbers) {
      const auto word = static_cast<std::uint32_t>(number);
      stream.write(reinterpret_cast<const char*>(&word), sizeof word);
    }
  };
  put({kMagic, 2, 12 + 8 + json.size() + 8 + content.binary.size(), json.size(), kJsonChunk});
  stream << json;
  put({content.binary.size(), kBinaryChunk});
  stream.write(content.binary.data(), static_cast<std::streamsize>(content.binary.size()));
}

}  // namespace splatbus::splats
