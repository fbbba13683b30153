#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <istream>
#include <stdexcept>

#include "gaussians/sh.h"
#include "splats/ply.h"
#include "splats/ply_header.h"

namespace splatbus::splats {
namespace {

static_assert(std::endian::native == std::endian::little, "rows are read as they lie in the file");

constexpr std::size_t kRowsAtOnce = 4096;

/// One property of the file and the plane that it fills: row `row` of that member.
struct Column {
  PlyProperty property;
  std::vector<float> GaussiansBuffer::*planes = nullptr;
  std::size_t row = 0;

  [[nodiscard]] float* plane(GaussiansBuffer& model) const { return (model.*planes).data() + row * model.stride(); }
};

template <typename T>
float value_at(const char* bytes) {
  T value{};
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<float>(value);
}

float read_value(const char* bytes, PlyType type) {
  switch (type) {
    case PlyType::Int8:
      return value_at<std::int8_t>(bytes);
    case PlyType::UInt8:
      return value_at<std::uint8_t>(bytes);
    case PlyType::Int16:
      return value_at<std::int16_t>(bytes);
    case PlyType::UInt16:
      return value_at<std::uint16_t>(bytes);
    case PlyType::Int32:
      return value_at<std::int32_t>(bytes);
    case PlyType::UInt32:
      return value_at<std::uint32_t>(bytes);
    case PlyType::Float32:
      return value_at<float>(bytes);
    case PlyType::Float64:
      return value_at<double>(bytes);
  }
  return 0;
}

int degree_from(const PlyHeader& header, const std::string& path) {
  const auto rest = std::count_if(header.properties.begin(), header.properties.end(),
                                  [](const PlyProperty& p) { return p.name.rfind("f_rest_", 0) == 0; });
  for (int degree = 0; degree <= kMaxShDegree; ++degree) {
    const ParameterLayout layout{Appearance::Radiance, degree};
    if (rest == std::ptrdiff_t{3} * (layout.sh_coefficients() - 1)) return degree;
  }
  throw std::runtime_error(
      fmt::format("{}: header: {} properties f_rest_*; degrees 0 to 3 have 0, 9, 24 or 45", path, rest));
}

/// Which property of the file fills which plane.
std::vector<Column> match_columns(const PlyHeader& header, const ParameterLayout& layout, const std::string& path) {
  std::vector<Column> columns;
  const auto parameter = [&](const std::string& name, int channel) {
    const PlyProperty* property = header.find(name);
    if (property == nullptr) {
      throw std::runtime_error(fmt::format("{}: header: the element vertex has no property \"{}\"", path, name));
    }
    columns.push_back({*property, &GaussiansBuffer::parameters, static_cast<std::size_t>(channel)});
  };
  constexpr std::array<const char*, 3> kPosition = {"x", "y", "z"}, kNormal = {"nx", "ny", "nz"};
  for (int axis = 0; axis < 3; ++axis) {
    const auto a = static_cast<std::size_t>(axis);
    parameter(kPosition[a], ParameterLayout::kMean + axis);
    parameter(fmt::format("scale_{}", axis), ParameterLayout::kLogScale + axis);
    parameter(fmt::format("f_dc_{}", axis), ParameterLayout::kAppearance + axis);
    if (const PlyProperty* normal = header.find(kNormal[a])) columns.push_back({*normal, &GaussiansBuffer::normal, a});
  }
  for (int k = 0; k < 4; ++k) parameter(fmt::format("rot_{}", k), ParameterLayout::kRotation + k);
  parameter("opacity", ParameterLayout::kOpacityLogit);
  const int rest = layout.sh_coefficients() - 1;
  for (int color = 0; color < 3; ++color) {
    for (int k = 0; k < rest; ++k) {  // the file has all of red before green, we have coefficient by coefficient
      parameter(fmt::format("f_rest_{}", color * rest + k), ParameterLayout::kAppearance + 3 * (k + 1) + color);
    }
  }
  return columns;
}

/// Checks rows [first, last), so that whoever renders the model needs no check.
void check_rows(GaussiansBuffer& model, const PlyHeader& header, const std::vector<Column>& columns, std::size_t first,
                std::size_t last, const std::string& path) {
  for (std::size_t i = first; i < last; ++i) {
    const std::size_t row_offset = header.vertex_offset + i * header.vertex_bytes;
    for (const Column& column : columns) {
      const float value = column.plane(model)[i];
      if (std::isfinite(value)) continue;
      throw std::runtime_error(fmt::format("{}: byte {}: vertex {}: {} is {}", path,
                                           row_offset + column.property.offset, i, column.property.name, value));
    }
    float length2 = 0;
    for (int k = 0; k < 4; ++k) {
      const float q = model.view().plane(ParameterLayout::kRotation + k)[i];
      length2 += q * q;
    }
    if (!(length2 > 0 && std::isfinite(length2))) {
      throw std::runtime_error(
          fmt::format("{}: byte {}: vertex {}: the rotation has no usable length", path, row_offset, i));
    }
  }
}

}  // namespace

SplatFile read_ply(std::istream& stream, const std::string& name, Axes axes) {
  stream.seekg(0, std::ios::end);
  const std::streamoff size = stream.tellg();
  if (!stream || size < 0) throw std::runtime_error(fmt::format("{}: not a regular file", name));
  stream.seekg(0);
  const PlyHeader header = read_ply_header(stream, name, static_cast<std::size_t>(size));
  if (header.find("packed_position") != nullptr) {
    throw std::runtime_error(
        fmt::format("{}: header: a compressed PLY of SuperSplat; splat-transform converts it to a plain one", name));
  }
  const ParameterLayout layout{Appearance::Radiance, degree_from(header, name)};
  const std::vector<Column> columns = match_columns(header, layout, name);
  SplatFile out{GaussiansBuffer(layout, header.vertex_count), header.mip};  // at least 14 bytes of the file for each
  GaussiansBuffer& model = out.gaussians;

  stream.seekg(static_cast<std::streamoff>(header.vertex_offset));
  std::vector<char> rows(std::min(kRowsAtOnce, model.count()) * header.vertex_bytes);
  for (std::size_t first = 0; first < model.count(); first += kRowsAtOnce) {
    const std::size_t count = std::min(kRowsAtOnce, model.count() - first);
    if (!stream.read(rows.data(), static_cast<std::streamsize>(count * header.vertex_bytes))) {
      throw std::runtime_error(fmt::format("{}: byte {}: the file cannot be read further", name,
                                           header.vertex_offset + first * header.vertex_bytes));
    }
    for (const Column& column : columns) {
      float* plane = column.plane(model);
      const char* source = rows.data() + column.property.offset;
      for (std::size_t i = 0; i < count; ++i) {
        plane[first + i] = read_value(source + i * header.vertex_bytes, column.property.type);
      }
    }
    check_rows(model, header, columns, first, first + count, name);
  }
  if (axes == Axes::Turn || (axes == Axes::OfFormat && !header.y_up)) turn(model);
  const float* mean = model.view().plane(ParameterLayout::kMean);
  std::copy_n(mean, 3 * model.stride(), model.surface_point.begin());
  for (std::size_t i = 0; i < model.count(); ++i) model.gaussian_id[i] = i;
  return out;
}

}  // namespace splatbus::splats
