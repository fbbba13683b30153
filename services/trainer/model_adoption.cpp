// How a ModelStore comes by its slabs: made, adopted from a trainer that was killed, or moved to.

#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <new>
#include <numeric>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "trainer/model_store.h"

namespace splatbus::trainer {

namespace {

constexpr std::size_t kSlot = 0;
constexpr const char* kHeaderRole = "model-header";
/// The planes' slab is one of these; the other one is what they move to.
constexpr std::array<const char*, 2> kPlanesRoles = {"model", "model-grown"};

/// What is wrong with a header as that of a model of this layout; empty when nothing is.
std::string header_fault(const bus::Slab& slab, const ParameterLayout& layout) {
  if (slab.descriptor().kind != Device::Cpu || slab.slots() != 1 || slab.slot_bytes() < sizeof(SlabHeader)) {
    return "it is too small for a model's header";
  }
  const auto& header = *reinterpret_cast<const SlabHeader*>(slab.slot_data(kSlot));
  if (header.magic != SlabHeader::kMagic || header.version != SlabHeader::kVersion) return "it does not hold a model";
  const bool other_degree = layout.appearance == Appearance::Radiance &&  // Transfer has no use for it
                            header.sh_degree != static_cast<std::uint32_t>(layout.sh_degree);
  if (header.appearance != static_cast<std::uint32_t>(layout.appearance) || other_degree ||
      header.channels != static_cast<std::uint32_t>(layout.channels())) {
    return "its appearance is another one";
  }
  const std::uint32_t current = header.current.load();
  if (current > 1) return "it names no current structure";
  const Structure& structure = header.structure.at(current);
  if (structure.capacity == 0 || structure.capacity > (1U << 26) || structure.capacity % 16 != 0) {
    return "it claims a capacity of " + std::to_string(structure.capacity);
  }
  if (structure.count > structure.capacity || structure.batch_count > kRememberedBatches) {
    return "its counts contradict each other";
  }
  return {};
}

}  // namespace

ModelStore::ModelStore(std::shared_ptr<bus::Context> bus, const ParameterLayout& layout, std::size_t capacity,
                       std::size_t max_gaussians, Device memory)
    : bus_(std::move(bus)), max_gaussians_(max_gaussians), memory_(memory), columns_(make_model_columns(memory)) {
  planes_.layout = layout;
  // Registering anything waits for the broker; asked before that, it would seem to hold no model.
  bus_->create_slab("start", 1, 4096);
  bus_->drop_slab("start");
  if (!adopt()) {
    begin_empty(capacity);
    return;
  }
  if (planes_slab_->descriptor().kind != memory_) {  // the trainer before had another backend
    planes_slab_->begin_write(kSlot);
    move_planes(this->capacity());
  }
  repair();
  origin_ = "adopted " + std::to_string(count()) + " Gaussians at step " + std::to_string(step());
}

bool ModelStore::adopt() {
  const std::string name = bus_->source() + "/" + kHeaderRole;
  const auto useless = [&](const std::string& why) {
    origin_ = "empty, for " + name + " is of no use: " + why;
    return false;
  };
  try {
    auto slab = bus_->adopt_slab(name);
    if (!slab) {
      origin_ = "empty";
      return false;
    }
    if (const std::string wrong = header_fault(*slab, planes_.layout); !wrong.empty()) return useless(wrong);
    auto* const header = reinterpret_cast<SlabHeader*>(slab->slot_data(kSlot));
    const Structure structure = header->structure.at(header->current.load());
    auto planes = adopt_planes(structure);
    header_slab_ = std::move(slab);
    header_ = header;
    structure_ = structure;
    bind(std::move(planes), structure.capacity);
    bus_->drop_slab(spare_role());  // of a move that was cut short
    return true;
  } catch (const bus::Error& error) {
    return useless(error.what());
  }
}

std::shared_ptr<bus::Slab> ModelStore::adopt_planes(const Structure& structure) const {
  std::string missing = "its planes are gone";
  for (const char* role : kPlanesRoles) {
    const std::string name = bus_->source() + "/" + role;
    try {
      auto slab = bus_->adopt_slab(name);
      if (!slab) continue;
      if (slab->id() != structure.planes_slab) {
        missing = name + " holds planes of another model";
      } else if (slab->slots() != 1 || slab->slot_bytes() < SlabLayout(planes_.layout, structure.capacity).bytes) {
        missing = name + " is too small for a capacity of " + std::to_string(structure.capacity);
      } else {
        return slab;
      }
    } catch (const bus::Error& error) {
      missing = error.what();
    }
  }
  throw bus::Error(missing);
}

void ModelStore::repair() {
  // Downloads a few bytes a column when the model lies on the device: once a start.
  auto [ids, dead] = columns_->inspect(planes_, count());
  std::vector<std::uint32_t> by_id(count());
  std::iota(by_id.begin(), by_id.end(), 0U);
  std::sort(by_id.begin(), by_id.end(),
            [&, &id = ids](std::uint32_t a, std::uint32_t b) { return std::pair(id[a], a) < std::pair(id[b], b); });
  for (std::size_t k = 0; k + 1 < by_id.size(); ++k) {
    // A removal that was cut short leaves a column twice; the later one is whole.
    if (ids[by_id[k]] == ids[by_id[k + 1]]) dead[by_id[k]] = 1;
  }
  if (!by_id.empty()) {
    structure_.next_gaussian_id = std::max(structure_.next_gaussian_id, ids[by_id.back()] + 1);
  }
  const auto marks = bus::allocate_memory(memory_, count());
  bus::copy_memory(marks.get(), memory_, dead.data(), Device::Cpu, count());
  bus::finish_copies();
  change([&] { remove(reinterpret_cast<const std::uint8_t*>(marks.get())); });
}

void ModelStore::begin_empty(std::size_t capacity) {
  capacity = rounded_capacity(capacity);
  bus_->drop_slab(kPlanesRoles[1]);
  bind(create_planes(kPlanesRoles[0], capacity), capacity);
  planes_slab_->begin_write(kSlot);
  header_slab_ = bus_->create_slab(kHeaderRole, 1, sizeof(SlabHeader));
  header_ = new (header_slab_->slot_data(kSlot)) SlabHeader{};
  header_->version = SlabHeader::kVersion;
  header_->appearance = static_cast<std::uint32_t>(planes_.layout.appearance);
  header_->sh_degree = static_cast<std::uint32_t>(planes_.layout.sh_degree);
  header_->channels = static_cast<std::uint32_t>(planes_.layout.channels());
  structure_ = Structure{.planes_slab = planes_slab_->id(), .capacity = capacity, .generation = 1};
  commit();
  header_->magic = SlabHeader::kMagic;
  slot_generation_ = planes_slab_->end_write(kSlot);
}

std::shared_ptr<bus::Slab> ModelStore::create_planes(const std::string& role, std::size_t capacity) const {
  constexpr int kTimeout_ms = 10000;
  return bus_->create_slab(role, 1, SlabLayout(planes_.layout, capacity).bytes, kTimeout_ms, memory_);
}

void ModelStore::bind(std::shared_ptr<bus::Slab> slab, std::size_t capacity) {
  planes_slab_ = std::move(slab);
  planes_ = ModelPlanes(planes_.layout, capacity, planes_slab_->slot_data(kSlot));
}

std::string ModelStore::spare_role() const {
  return planes_slab_->name().ends_with(kPlanesRoles[1]) ? kPlanesRoles[0] : kPlanesRoles[1];
}

std::size_t ModelStore::capacity_for(std::size_t count) const {
  return count <= capacity() ? capacity() : rounded_capacity(std::max(count, 2 * capacity()));
}

void ModelStore::reserve(std::size_t needed) {
  if (needed <= capacity()) return;
  move_planes(capacity_for(needed));
  spdlog::info("model: moved to a slab for {} Gaussians", capacity());
}

void ModelStore::move_planes(std::size_t capacity) {
  const std::string role = spare_role();
  const auto old_slab = planes_slab_;
  const std::string old_role = role == kPlanesRoles[0] ? kPlanesRoles[1] : kPlanesRoles[0];
  auto slab = create_planes(role, capacity);
  slab->begin_write(kSlot);
  const ModelPlanes target(planes_.layout, capacity, slab->slot_data(kSlot));
  copy_columns(target, memory_, planes_, old_slab->descriptor().kind, count());
  bind(std::move(slab), capacity);
  structure_.planes_slab = planes_slab_->id();
  structure_.capacity = capacity;
  commit();
  old_slab->end_write(kSlot);
  bus_->drop_slab(old_role);
}

}  // namespace splatbus::trainer
