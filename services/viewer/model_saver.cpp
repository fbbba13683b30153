#include "viewer/model_saver.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <exception>
#include <stdexcept>
#include <vector>

#include "splats/file.h"
#include "stream/display_gaussians.h"

namespace splatbus::viewer {
namespace {

using namespace std::chrono_literals;

constexpr float kHiddenLogit = -100;  // rows of nobody, which DisplayGaussians leave in its ranges

/// Gaussians, and what they see of each light.
struct Compact {
  GaussiansBuffer gaussians;
  std::vector<std::uint8_t> seen;  ///< [lights][count], empty where the view had none
  std::uint32_t lights = 0;

  [[nodiscard]] GaussiansView view() const {
    GaussiansView view = gaussians.view();
    if (seen.empty()) return view;
    view.visibility_u8 = seen.data();
    view.visibility_stride = gaussians.count();
    view.visibility_rows = lights;
    return view;
  }
};

/// Without pages and rows of nobody, as BakedModel wants it.
Compact compact(const GaussiansView& view) {
  std::vector<std::uint32_t> rows;
  for (const IndexRange& range : view.ranges) {
    for (std::uint32_t row = range.first; row < range.first + range.count; ++row) {
      if (*view.at(ParameterLayout::kOpacityLogit, row) > kHiddenLogit) rows.push_back(row);
    }
  }
  Compact compact{.gaussians = GaussiansBuffer(view.layout, rows.size()), .seen = {}};
  GaussiansBuffer& out = compact.gaussians;
  const auto channels = static_cast<std::size_t>(view.layout.channels());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const std::size_t row = view.offset(rows[i]);
    for (std::size_t c = 0; c < channels; ++c) {
      out.parameters[c * out.stride() + i] = view.parameters[c * view.stride + row];
    }
    for (std::size_t c = 0; c < 3 && view.normal; ++c)
      out.normal[c * out.stride() + i] = view.normal[c * view.stride + row];
    if (view.visibility) out.visibility[i] = view.visibility[row];
    if (view.object_id) out.object_id[i] = view.object_id[row];
  }
  if (view.visibility_u8) {
    compact.lights = view.visibility_rows;
    compact.seen.reserve(compact.lights * rows.size());
    for (std::size_t light = 0; light < compact.lights; ++light) {
      for (const std::uint32_t row : rows) {
        compact.seen.push_back(view.visibility_u8[light * view.visibility_stride + row]);
      }
    }
  }
  return compact;
}

std::string save(std::future<ShownModel> copy, const std::string& path) {
  try {
    if (copy.wait_for(10s) != std::future_status::ready)
      throw std::runtime_error(path + ": the stream does not answer");
    const ShownModel model = copy.get();
    stream::DisplayGaussians shown;
    shown.apply(model.changes);
    const std::size_t count =
        splats::write_file(path, compact(shown.view(model.scene.light.sources)).view(), model.scene);
    return fmt::format("{}: {} Gaussians", path, count);
  } catch (const std::exception& error) {
    return error.what();
  }
}

}  // namespace

ModelSaver::~ModelSaver() {
  if (outcome_.valid()) spdlog::info("{}", outcome_.get());
}

bool ModelSaver::begin(StreamReceiver& receiver, const std::string& path) {
  if (outcome_.valid()) return false;
  outcome_ = std::async(std::launch::async, save, receiver.copy_model(), path);
  return true;
}

std::optional<std::string> ModelSaver::take_outcome() {
  if (!outcome_.valid() || outcome_.wait_for(0s) != std::future_status::ready) return std::nullopt;
  return outcome_.get();
}

}  // namespace splatbus::viewer
