#include "model/page_filling.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <map>
#include <span>
#include <utility>
#include <vector>

#include "model/channels.h"
#include "model/page_content.h"
#include "model/page_kernels.h"

namespace splatbus::model {

namespace {

/// What lies packed beside the model at a time is bounded.
constexpr std::size_t kPagesAtOnce = 64;

struct Placed {
  std::uint64_t morton;
  std::size_t index;
};

/// By frame of reference, each along the curve.
std::map<std::uint32_t, std::vector<Placed>> placed(const GaussiansView& gaussians) {
  std::map<std::uint32_t, std::vector<Placed>> frames;
  for (std::size_t i = 0; i < gaussians.count; ++i) {
    const math::Vec3 mean{gaussians.plane(0)[i], gaussians.plane(1)[i], gaussians.plane(2)[i]};
    // One that is nowhere has no key; restore() leaves out whatever else is not finite.
    if (!std::isfinite(mean.x) || !std::isfinite(mean.y) || !std::isfinite(mean.z)) continue;
    const std::uint32_t frame = gaussians.object_id != nullptr ? gaussians.object_id[i] : kWorldFrame;
    frames[frame].push_back({morton_key(mean), i});
  }
  for (auto& [id, members] : frames) {
    std::sort(members.begin(), members.end(), [](const Placed& a, const Placed& b) {
      return std::pair(a.morton, a.index) < std::pair(b.morton, b.index);
    });
  }
  return frames;
}

/// As PageContent has them.
std::vector<std::uint32_t> packed(const GaussiansView& gaussians, std::span<const Placed> members) {
  const std::size_t count = members.size();
  std::vector<std::uint32_t> words(content_words(gaussians.layout, static_cast<std::uint32_t>(count)), 0);
  const auto put = [&](Channel channel, const float* planes) {
    const ChannelRows rows = rows_of(channel, gaussians.layout);
    if (planes == nullptr) return;
    for (std::uint32_t row = 0; row < rows.rows; ++row) {
      std::uint32_t* const to = words.data() + std::size_t{rows.first + row} * count;
      const float* const from = planes + std::size_t{row} * gaussians.stride;
      for (std::size_t k = 0; k < count; ++k) to[k] = std::bit_cast<std::uint32_t>(from[members[k].index]);
    }
  };
  put(Channel::Parameters, gaussians.parameters);
  put(Channel::Average, gaussians.parameters);
  put(Channel::Normal, gaussians.normal);
  put(Channel::SurfacePoint, gaussians.surface_point != nullptr ? gaussians.surface_point : gaussians.plane(0));
  put(Channel::Visibility, gaussians.visibility);
  std::uint32_t* const ids = words.data() + std::size_t{rows_of(Channel::GaussianId, gaussians.layout).first} * count;
  for (std::size_t k = 0; k < count; ++k) {
    const std::uint64_t id = members[k].index + 1;  // 0 is nobody's
    std::memcpy(ids + 2 * k, &id, sizeof(id));
  }
  return words;
}

}  // namespace

std::size_t fill_frozen(PageStore& store, const GaussiansView& gaussians) {
  const std::size_t before = store.count();
  std::vector<std::vector<std::uint32_t>> words;
  std::vector<PageContent> pages;
  const auto put_in = [&] {
    (void)store.restore(pages, gaussians.count + 1);
    pages.clear();
    words.clear();
  };
  for (const auto& [frame_id, members] : placed(gaussians)) {
    for (std::size_t first = 0; first < members.size(); first += kPageLanes) {
      const auto here = std::span(members).subspan(first, std::min<std::size_t>(kPageLanes, members.size() - first));
      PageStructure structure{
          .state = PageState::Frozen, .frame_id = frame_id, .count = static_cast<std::uint32_t>(here.size())};
      // A frame's first page begins where the curve does.
      if (first > 0) {
        structure.morton_first = here[0].morton;
        structure.id_first = here[0].index + 1;
      }
      words.push_back(packed(gaussians, here));
      pages.push_back({structure, words.back()});
      if (pages.size() == kPagesAtOnce) put_in();
    }
  }
  put_in();
  return store.count() - before;
}

}  // namespace splatbus::model
