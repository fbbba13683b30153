// How a ModelStore comes by its slab: made, adopted from a trainer that was killed, or grown.

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <new>
#include <numeric>
#include <optional>
#include <utility>

#include "bus/error.h"
#include "trainer/model_store.h"

namespace splatbus::trainer {

namespace {

constexpr std::size_t kSlot = 0;
constexpr const char* kRole = "model";
constexpr const char* kGrownRole = "model-grown";
constexpr float kInvisibleLogit = -15.0F;

/// What is wrong with a slab's content as a model of this layout; empty when nothing is.
std::string fault(const bus::Slab& slab, const ParameterLayout& layout) {
  if (slab.slots() != 1 || slab.slot_bytes() < sizeof(SlabHeader)) return "it is too small for a model";
  const auto& header = *reinterpret_cast<const SlabHeader*>(slab.slot_data(kSlot));
  if (header.magic != SlabHeader::kMagic || header.version != SlabHeader::kVersion) return "it does not hold a model";
  const bool other_degree = layout.appearance == Appearance::Radiance &&  // Transfer has no use for it
                            header.sh_degree != static_cast<std::uint32_t>(layout.sh_degree);
  if (header.appearance != static_cast<std::uint32_t>(layout.appearance) || other_degree ||
      header.channels != static_cast<std::uint32_t>(layout.channels())) {
    return "its appearance is another one";
  }
  if (header.capacity == 0 || header.capacity > (1U << 26) || header.capacity % 16 != 0 ||
      SlabLayout(layout, header.capacity).bytes > slab.slot_bytes()) {
    return "its capacity of " + std::to_string(header.capacity) + " does not fit its size";
  }
  const std::uint32_t current = header.current.load();
  if (current > 1) return "it names no current structure";
  const Structure& structure = header.structure.at(current);
  if (structure.count > header.capacity || structure.batch_count > kRememberedBatches ||
      structure.frozen > structure.count) {
    return "its counts contradict each other";
  }
  return {};
}

bool finite_column(const ModelPlanes& planes, std::size_t column) {
  const auto finite = [&](const float* plane, std::size_t channels) {
    for (std::size_t c = 0; c < channels; ++c) {
      if (!std::isfinite(plane[c * planes.capacity + column])) return false;
    }
    return true;
  };
  const auto channels = static_cast<std::size_t>(planes.layout.channels());
  return finite(planes.parameters, channels) && finite(planes.average, channels) && finite(planes.normal, 3) &&
         finite(planes.surface_point, 3) && finite(planes.visibility, 1);
}

}  // namespace

ModelStore::ModelStore(std::shared_ptr<bus::Context> bus, const ParameterLayout& layout, std::size_t capacity,
                       std::size_t max_gaussians)
    : bus_(std::move(bus)), max_gaussians_(max_gaussians) {
  planes_.layout = layout;
  // Registering anything waits for the broker; asked before that, it would seem to hold no model.
  bus_->create_slab("start", 1, 4096);
  bus_->drop_slab("start");
  // A trainer that is killed while its model moves to a larger slab leaves both: the newer one counts.
  std::optional<std::string> best;
  std::uint64_t best_generation = 0;
  for (const char* role : {kRole, kGrownRole}) {
    if (adopt(role) && (!best || structure_.generation > best_generation)) {
      best = role;
      best_generation = structure_.generation;
    }
  }
  if (!best) {
    create(capacity);
    if (origin_.empty()) origin_ = "empty";
    return;
  }
  adopt(*best);
  repair();
  origin_ = "adopted " + std::to_string(count()) + " Gaussians at step " + std::to_string(step());
}

bool ModelStore::adopt(const std::string& role) {
  const std::string name = bus_->source() + "/" + role;
  try {
    auto slab = bus_->adopt_slab(name);
    if (!slab) return false;
    const std::string wrong = fault(*slab, planes_.layout);
    if (!wrong.empty()) {
      origin_ = "empty, for " + name + " is of no use: " + wrong;
      return false;
    }
    role_ = role;
    const std::size_t capacity = reinterpret_cast<const SlabHeader*>(slab->slot_data(kSlot))->capacity;
    bind(std::move(slab), capacity);
    structure_ = header_->structure.at(header_->current.load());
    return true;
  } catch (const bus::Error& error) {
    origin_ = "empty, for " + name + " is of no use: " + error.what();
    return false;
  }
}

void ModelStore::repair() {
  std::vector<std::uint8_t> dead(count(), 0);
  std::vector<std::uint32_t> by_id(count());
  std::iota(by_id.begin(), by_id.end(), 0U);
  std::sort(by_id.begin(), by_id.end(), [&](std::uint32_t a, std::uint32_t b) {
    const auto id = [&](std::uint32_t i) { return std::pair(planes_.gaussian_id[i], i); };
    return id(a) < id(b);
  });
  for (std::size_t k = 0; k + 1 < by_id.size(); ++k) {
    // A removal that was cut short leaves a column twice; the later one is whole.
    if (planes_.gaussian_id[by_id[k]] == planes_.gaussian_id[by_id[k + 1]]) dead[by_id[k]] = 1;
  }
  const float* const logits = planes_.parameters + ParameterLayout::kOpacityLogit * planes_.capacity;
  for (std::size_t i = 0; i < count(); ++i) {
    if (logits[i] < kInvisibleLogit || !finite_column(planes_, i)) dead[i] = 1;
  }
  if (!by_id.empty()) {
    structure_.next_gaussian_id = std::max(structure_.next_gaussian_id, planes_.gaussian_id[by_id.back()] + 1);
  }
  change([&] { remove(dead); });
}

void ModelStore::create(std::size_t capacity) {
  capacity = rounded_capacity(capacity);
  auto slab = bus_->create_slab(role_, 1, SlabLayout(planes_.layout, capacity).bytes);
  slab->begin_write(kSlot);
  auto* const header = new (slab->slot_data(kSlot)) SlabHeader{};
  header->version = SlabHeader::kVersion;
  header->appearance = static_cast<std::uint32_t>(planes_.layout.appearance);
  header->sh_degree = static_cast<std::uint32_t>(planes_.layout.sh_degree);
  header->channels = static_cast<std::uint32_t>(planes_.layout.channels());
  header->capacity = capacity;
  header->magic = SlabHeader::kMagic;
  bind(slab, capacity);
  structure_ = Structure{.generation = 1};
  commit();
  slot_generation_ = slab_->end_write(kSlot);
}

void ModelStore::bind(std::shared_ptr<bus::Slab> slab, std::size_t capacity) {
  slab_ = std::move(slab);
  header_ = reinterpret_cast<SlabHeader*>(slab_->slot_data(kSlot));
  planes_ = ModelPlanes(planes_.layout, capacity, slab_->slot_data(kSlot));
}

std::string ModelStore::spare_role() const {
  return role_ == kRole ? kGrownRole : kRole;
}

void ModelStore::reserve(std::size_t needed) {
  if (needed <= capacity()) return;
  const auto old_slab = slab_;
  const ModelPlanes old_planes = planes_;
  const Structure pending = structure_;
  const std::string old_role = role_;
  const SlabHeader& old_header = *header_;

  role_ = spare_role();
  try {
    create(std::max(needed, 2 * old_planes.capacity));
  } catch (...) {
    role_ = old_role;
    structure_ = pending;
    throw;
  }
  slab_->begin_write(kSlot);
  planes_.copy_from(old_planes, pending.count);
  header_->step = old_header.step;
  header_->views = old_header.views;
  header_->optimizer_s = old_header.optimizer_s;
  structure_ = pending;
  structure_.generation += 1;
  commit();
  structure_.generation -= 1;
  old_slab->end_write(kSlot);
  bus_->drop_slab(old_role);
  spdlog::info("model: moved to a slab for {} Gaussians", capacity());
}

}  // namespace splatbus::trainer
