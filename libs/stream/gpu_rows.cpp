#include "stream/gpu_rows.h"

#include <algorithm>
#include <glm/glm.hpp>
#include <optional>
#include <span>
#include <utility>

#include "gaussians/frames.h"
#include "gaussians/player.h"

namespace splatbus::stream {

namespace {

constexpr std::uint32_t kHidden = 0xFFFFFFFFU;

GpuRows::Transform matrix_of(const ObjectTransform& transform) {
  const glm::mat3 rotation = glm::mat3_cast(transform.rigid.rotation);
  GpuRows::Transform out{};
  auto to = out.begin();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) *to++ = transform.scale * rotation[column][row];
    *to++ = transform.rigid.translation[row];
  }
  return out;
}

/// For an eye in the origin; nullopt for what is hidden.
std::optional<ObjectTransform> transform_in(const SceneState& scene, std::uint32_t object_id) {
  if (object_id == kWorldFrame) return ObjectTransform{};
  const auto found = scene.objects.find(object_id);
  if (found == scene.objects.end()) return std::nullopt;
  return seen_from(glm::vec3(0), object_id, found->second);
}

/// What makes no difference to colours is left out.
Light shading_light(const Light& light, const ObjectTransform& object) {
  Light out = light_in_object(light, object);
  out.generation = 0;
  out.background = glm::vec3(0);
  return out;
}

}  // namespace

void GpuRows::on_reset(const ReplicatedState& shown) {
  stale_.assign(stale_.size(), kRecord);
  unsent_ = stale_.size();
  recolored_ = 0;
  stale_.resize(std::max(stale_.size(), shown.rows()), kNothing);
  origin_.resize(stale_.size(), kNoRow);
  // Another state is mostly the same world again: it takes the place of what was there row by row.
  for (std::uint32_t row = 0; row < shown_.size() * kBlockRows; ++row) {
    if (!is_shown(row) || origin_[row] != row) origin_[row] = kNoRow;
  }
  any_moved_ = false;
  shown_.assign(stale_.size() / kBlockRows, 0);
  for (const auto& [number, page] : shown.pages) {
    for (std::uint32_t k = 0; k < HeldPage::blocks_of(page.count); ++k) show(page.blocks[k], page.shown[k]);
  }
  forget_objects();
}

void GpuRows::forget_objects() {
  objects_.assign(1, {});
  index_of_object_ = {{kWorldFrame, 0}};
  far_field_ = 0;
  player_ = 0;
  objects_are_full_ = false;
  objects_are_new_ = true;
}

void GpuRows::on_change(const ReplicatedState& shown, const Change& change) {
  if (shown.rows() > stale_.size()) {
    stale_.resize(shown.rows(), kNothing);
    shown_.resize(shown.rows() / kBlockRows, 0);
    origin_.resize(shown.rows(), kNoRow);
  }
  follow_moves(change.moves);
  for (const std::uint32_t row : change.arrivals) origin_[row] = kNoRow;
  for (const Change::Block& block : change.blocks) show(block.block, block.count);
  mark_all(change.rows, kRecord);
  mark_all(change.objects, kRecord);
  const bool harmonics = harmonic_words(shown.layout) > 0;
  for (const Change::Values& values : change.values) {
    const Attribute a = values.attribute;
    const bool shape =
        a == Attribute::Mean || a == Attribute::LogScale || a == Attribute::Rotation || a == Attribute::Opacity;
    mark_all(values.rows, shape || harmonics ? kRecord : kColor);
  }
  for (const Change::Seen& seen : change.seen) mark_all(seen.rows, kColor);
  if (change.scene && objects_are_full_) {  // of some that are long gone
    forget_objects();
    forget_taken();
  }
}

void GpuRows::follow_moves(const std::vector<Change::Move>& moves) {
  std::vector<std::uint32_t> origins;
  origins.reserve(moves.size());
  for (const Change::Move& move : moves) origins.push_back(is_shown(move.from) ? origin_[move.from] : kNoRow);
  for (std::size_t k = 0; k < moves.size(); ++k) origin_[moves[k].to] = origins[k];
  any_moved_ = any_moved_ || !moves.empty();
}

std::vector<bool> GpuRows::moved_away() const {
  if (!any_moved_) return {};
  std::vector<bool> moved(stale_.size());
  for (std::uint32_t row = 0; row < stale_.size(); ++row) {
    if (has_moved(row)) moved[origin_[row]] = true;
  }
  return moved;
}

void GpuRows::take_turnover(const std::vector<std::uint32_t>& rows, const std::vector<bool>& moved, Turnover& out) {
  out = {};
  for (const std::uint32_t row : rows) {
    out.origins.push_back(is_shown(row) ? origin_[row] : kNoRow);
    out.left.push_back(out.origins.back() == row || (!moved.empty() && moved[row]) ? 0 : 1);
  }
}

void GpuRows::show(std::uint32_t block, std::uint32_t count) {
  const std::uint32_t before = std::exchange(shown_[block], count);
  for (std::uint32_t i = std::min(before, count); i < std::max(before, count); ++i) {
    mark(block * kBlockRows + i, kRecord);
  }
}

void GpuRows::mark(std::uint32_t row, Stale what) {
  std::uint8_t& stale = stale_[row];
  if (stale >= what) return;
  if (stale == kColor) --recolored_;
  stale = what;
  ++(what == kColor ? recolored_ : unsent_);
}

// A row that is not shown is free on the GPU, and is marked when that changes.
void GpuRows::mark_all(const std::vector<std::uint32_t>& rows, Stale what) {
  for (const std::uint32_t row : rows) {
    if (is_shown(row)) mark(row, what);
  }
}

void GpuRows::forget_taken() {
  for (std::size_t row = 0; row < stale_.size(); ++row) mark(static_cast<std::uint32_t>(row), kRecord);
}

std::uint32_t GpuRows::index_of(std::uint32_t object_id) {
  const auto found = index_of_object_.find(object_id);
  if (found != index_of_object_.end()) return found->second;
  if (objects_.size() > kMaxObjects) {
    objects_are_full_ = true;
    return kHidden;
  }
  const auto index = static_cast<std::uint32_t>(objects_.size());
  index_of_object_.emplace(object_id, index);
  objects_.push_back({.id = object_id, .light = {}});
  if (object_id == kFarFieldFrame) far_field_ = index;
  objects_are_new_ = true;
  return index;
}

void GpuRows::find_player() {
  const bool there = replica_.scene().objects.contains(kPlayerId);
  const std::uint32_t index = there ? index_of(kPlayerId) : kHidden;
  player_ = index != kHidden ? index : 0;
}

void GpuRows::follow_scene() {
  const std::tuple key(replica_.epoch(), replica_.scene_version(), replica_.scene_instant().frame);
  if (!objects_are_new_ && key == scene_key_) return;
  find_player();
  objects_are_new_ = false;
  scene_key_ = key;
  const SceneState& scene = replica_.scene();
  std::vector<std::uint8_t> relit(objects_.size());
  bool any_relit = false;
  transforms_ = transforms_in(scene);
  for (std::size_t k = 0; k < objects_.size(); ++k) {
    Object& object = objects_[k];
    const std::optional<ObjectTransform> transform = transform_in(scene, object.id);
    if (!transform || (k > 0 && k == player_)) continue;
    Light light = shading_light(scene.light, *transform);
    if (light == object.light) continue;
    object.light = std::move(light);
    relit[k] = 1;
    any_relit = true;
  }
  if (!any_relit || replica_.layout().appearance != Appearance::Transfer) return;
  const SparseRows<std::uint32_t>& ids = replica_.shown().gaussians.object_id;
  std::uint32_t id = kWorldFrame, index = 0;
  for (std::uint32_t row = 0; row < ids.rows(); ++row) {
    if (!is_shown(row)) continue;
    if (ids[row] != id) {
      id = ids[row];
      const auto found = index_of_object_.find(id);
      index = found != index_of_object_.end() ? found->second : kHidden;
    }
    if (index != kHidden && relit[index]) mark(row, kColor);
  }
}

std::vector<GpuRows::Transform> GpuRows::transforms_in(const SceneState& scene) const {
  std::vector<Transform> transforms(objects_.size());
  for (std::size_t k = 0; k < objects_.size(); ++k) {
    if (const auto transform = transform_in(scene, objects_[k].id)) transforms[k] = matrix_of(*transform);
  }
  return transforms;
}

const std::vector<GpuRows::Transform>& GpuRows::transforms() {
  follow_scene();
  return transforms_;
}

void GpuRows::find_rows(std::size_t most, Stale wanted, std::size_t& cursor, std::vector<std::uint32_t>& rows) const {
  for (std::size_t seen = 0; rows.size() < most && seen < stale_.size(); ++seen, ++cursor) {
    if (cursor >= stale_.size()) cursor = 0;
    if (stale_[cursor] == wanted) rows.push_back(static_cast<std::uint32_t>(cursor));
  }
}

/// The colours of columns of what is shown.
class GpuRows::Shader {
 public:
  explicit Shader(const GpuRows& rows)
      : rows_(rows), state_(rows.replica_.shown()), maker_(state_.gaussians, state_.layout) {
    for (const LightSource& source : rows.replica_.scene().light.sources) {
      seen_.push_back(state_.light_rows.find(source.id));
    }
    visibility_.resize(1 + seen_.size());
  }

  [[nodiscard]] GpuRecord record(std::size_t column, std::uint32_t object_index) {
    GpuRecord out = maker_.record(column, object_index);
    out.color = color(column, object_index);
    return out;
  }
  void harmonics(std::size_t column, std::span<std::uint32_t> out) const { maker_.harmonics(column, out); }
  [[nodiscard]] std::uint32_t color(std::size_t column, std::uint32_t object_index) {
    const Light& light = rows_.objects_[object_index].light;
    visibility_.resize(1 + light.sources.size(), 1.0F);
    visibility_[0] = maker_.sun_visibility(column);
    for (std::size_t k = 1; k < visibility_.size() && k <= seen_.size(); ++k) {
      visibility_[k] = seen_[k - 1] ? static_cast<float>((*seen_[k - 1])[column]) / 255 : 1.0F;
    }
    return maker_.color(column, visibility_, light);
  }

 private:
  const GpuRows& rows_;
  const ReplicatedState& state_;
  RecordMaker maker_;
  std::vector<const Bytes*> seen_;  ///< of the scene's sources
  std::vector<float> visibility_;
};

void GpuRows::take_records(std::size_t most, std::vector<std::uint32_t>& rows, std::vector<GpuRecord>& records,
                           std::vector<std::uint32_t>* harmonics, Turnover* turnover) {
  rows.clear();
  const std::vector<bool> moved = turnover ? moved_away() : std::vector<bool>();
  for (std::uint32_t row = 0; row < moved.size(); ++row) {
    if (stale_[row] == kRecord && (moved[row] || has_moved(row))) rows.push_back(row);
  }
  for (const std::uint32_t row : rows) stale_[row] = kTaking;
  if (turnover) any_moved_ = false;
  find_rows(std::min(std::max(most, rows.size()), unsent_), kRecord, record_cursor_, rows);
  if (turnover) take_turnover(rows, moved, *turnover);
  const SparseRows<std::uint32_t>& object_ids = replica_.shown().gaussians.object_id;
  // The scene is followed for all objects before there is a colour.
  for (const std::uint32_t row : rows) {
    if (is_shown(row)) static_cast<void>(index_of(object_ids[row]));
  }
  follow_scene();
  records.assign(rows.size(), {});
  const std::size_t words = harmonics ? harmonic_words(replica_.shown().layout) : 0;
  if (harmonics) harmonics->assign(words * rows.size(), 0);
  Shader shader(*this);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    stale_[rows[k]] = kNothing;
    origin_[rows[k]] = rows[k];
    const std::uint32_t object = is_shown(rows[k]) ? index_of(object_ids[rows[k]]) : kHidden;
    if (object == kHidden) continue;
    records[k] = shader.record(rows[k], object);
    if (words > 0) shader.harmonics(rows[k], std::span(*harmonics).subspan(words * k, words));
  }
  unsent_ -= rows.size();
}

void GpuRows::take_colors(std::size_t most, std::vector<std::uint32_t>& rows, std::vector<std::uint32_t>& colors) {
  follow_scene();
  rows.clear();
  find_rows(std::min(most, recolored_), kColor, color_cursor_, rows);
  const SparseRows<std::uint32_t>& object_ids = replica_.shown().gaussians.object_id;
  colors.assign(rows.size(), 0);
  Shader shader(*this);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    stale_[rows[k]] = kNothing;
    const std::uint32_t object = is_shown(rows[k]) ? index_of(object_ids[rows[k]]) : kHidden;
    if (object != kHidden) colors[k] = shader.color(rows[k], object);
  }
  recolored_ -= rows.size();
}

}  // namespace splatbus::stream
