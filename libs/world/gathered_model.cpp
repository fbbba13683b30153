#include "world/gathered_model.h"

#include <algorithm>
#include <cstring>

#include "model/channels.h"

namespace splatbus::world {

GatheredModel gather_model(World& folder) {
  const ParameterLayout& layout = folder.layout();
  const std::map<PageKey, PageEntry> pages = folder.pages();
  std::size_t count = 0;
  for (const auto& [key, entry] : pages) count += entry.count;
  GatheredModel gathered{.gaussians = GaussiansBuffer(layout, count), .page_ends = {}};
  GaussiansBuffer& model = gathered.gaussians;
  std::size_t at = 0;
  for (const auto& [key, entry] : pages) {
    const auto page = folder.read(key);
    if (!page || page->count == 0) continue;
    const auto copy = [&](model::Channel channel, std::vector<float>& planes) {
      const model::ChannelRows rows = model::rows_of(channel, layout);
      for (std::size_t row = 0; row < rows.rows; ++row) {
        std::memcpy(planes.data() + row * model.stride() + at, page->words.data() + (rows.first + row) * page->count,
                    page->count * sizeof(float));
      }
    };
    copy(model::Channel::Average, model.parameters);
    copy(model::Channel::Normal, model.normal);
    copy(model::Channel::SurfacePoint, model.surface_point);
    copy(model::Channel::Visibility, model.visibility);
    std::memcpy(
        model.gaussian_id.data() + at,
        page->words.data() + std::size_t{model::rows_of(model::Channel::GaussianId, layout).first} * page->count,
        page->count * sizeof(std::uint64_t));
    std::fill_n(model.object_id.begin() + static_cast<std::ptrdiff_t>(at), page->count, key.frame_id);
    at += page->count;
    gathered.page_ends.push_back(at);
  }
  model.resize(at);
  return gathered;
}

}  // namespace splatbus::world
