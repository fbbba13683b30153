#include "stream/display_rows.h"

#include <algorithm>
#include <glm/glm.hpp>
#include <utility>

#include "gaussians/frames.h"

namespace splatbus::stream {

namespace {

constexpr std::uint32_t kFree = 0xFFFFFFFFU, kHidden = 0xFFFFFFFFU;

DisplayRows::Transform matrix_of(const ObjectTransform& transform) {
  const glm::mat3 rotation = glm::mat3_cast(transform.rigid.rotation);
  DisplayRows::Transform out{};
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      out[static_cast<std::size_t>(4 * row + column)] = transform.scale * rotation[column][row];
    }
    out[static_cast<std::size_t>(4 * row + 3)] = transform.rigid.translation[row];
  }
  return out;
}

/// What makes no difference to colours is left out.
Light shading_light(const Light& light, const ObjectTransform& object) {
  Light out = light_in_object(light, object);
  out.generation = 0;
  out.background = glm::vec3(0);
  return out;
}

}  // namespace

void DisplayRows::on_reset(const ReplicatedState& shown) {
  const std::size_t count = shown.gaussians.count(), rows = std::max(column_of_row_.size(), count);
  row_of_column_.resize(count);
  column_of_row_.assign(rows, kFree);
  free_.clear();
  for (std::size_t i = 0; i < count; ++i) {
    row_of_column_[i] = column_of_row_[i] = static_cast<std::uint32_t>(i);
  }
  for (std::size_t row = rows; row > count; --row) free_.push_back(static_cast<std::uint32_t>(row - 1));
  stale_.assign(rows, kRecord);
  unsent_ = rows;
  recolored_ = 0;
  columns_moved_ = false;
  forget_objects();
}

void DisplayRows::forget_objects() {
  objects_.assign(1, {});
  index_of_object_ = {{kWorldFrame, 0}};
  far_field_ = 0;
  objects_are_full_ = false;
  scene_is_new_ = true;
}

void DisplayRows::on_change(const ReplicatedState& shown, const Change& change) {
  switch (change.kind) {
    case Change::Kind::Nothing:
      break;
    case Change::Kind::Appended:
      for (const std::uint32_t column : change.slots) {
        const std::uint32_t row = new_row();
        row_of_column_.push_back(row);
        column_of_row_[row] = column;
        mark(row, kRecord);
      }
      break;
    case Change::Kind::Values: {
      const Attribute a = change.attribute;
      const bool shape =
          a == Attribute::Mean || a == Attribute::LogScale || a == Attribute::Rotation || a == Attribute::Opacity;
      for (const std::uint32_t column : change.slots) mark(row_of_column_[column], shape ? kRecord : kColor);
      break;
    }
    case Change::Kind::Seen:
      for (const std::uint32_t column : change.slots) mark(row_of_column_[column], kColor);
      break;
    case Change::Kind::Objects:
      for (const std::uint32_t column : change.slots) mark(row_of_column_[column], kRecord);
      break;
    case Change::Kind::Removed:
      for (const std::uint32_t column : change.slots) {
        const std::uint32_t row = row_of_column_[column];
        column_of_row_[row] = kFree;
        free_.push_back(row);
        mark(row, kRecord);
      }
      remove_at(row_of_column_, change.slots);
      columns_moved_ = true;
      break;
    case Change::Kind::Scene:
      scene_is_new_ = true;
      if (objects_are_full_) {  // of some that are long gone
        forget_objects();
        mark_all(kRecord);
      }
      break;
  }
  static_cast<void>(shown);
}

void DisplayRows::on_order(std::span<const std::uint32_t> order) {
  std::vector<std::uint32_t> rows(order.size());
  for (std::size_t i = 0; i < order.size(); ++i) rows[i] = row_of_column_[order[i]];
  row_of_column_ = std::move(rows);
  columns_moved_ = true;
}

std::uint32_t DisplayRows::new_row() {
  if (free_.empty()) {
    column_of_row_.push_back(kFree);
    stale_.push_back(kNothing);
    return static_cast<std::uint32_t>(column_of_row_.size() - 1);
  }
  const std::uint32_t row = free_.back();
  free_.pop_back();
  return row;
}

void DisplayRows::mark(std::uint32_t row, Stale what) {
  std::uint8_t& stale = stale_[row];
  if (stale >= what) return;
  if (stale == kColor) --recolored_;
  stale = what;
  ++(what == kColor ? recolored_ : unsent_);
}

void DisplayRows::mark_all(Stale what) {
  for (std::size_t row = 0; row < stale_.size(); ++row) {
    if (what == kRecord || column_of_row_[row] != kFree) mark(static_cast<std::uint32_t>(row), what);
  }
}

void DisplayRows::forget_taken() {
  mark_all(kRecord);
}

void DisplayRows::find_columns() {
  if (!columns_moved_) return;
  for (std::size_t i = 0; i < row_of_column_.size(); ++i) {
    column_of_row_[row_of_column_[i]] = static_cast<std::uint32_t>(i);
  }
  columns_moved_ = false;
}

std::uint32_t DisplayRows::index_of(std::uint32_t object_id) {
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
  scene_is_new_ = true;
  return index;
}

void DisplayRows::follow_scene() {
  if (!std::exchange(scene_is_new_, false)) return;
  const SceneState& scene = replica_.scene();
  std::vector<std::uint8_t> relit(objects_.size());
  bool any_relit = false;
  transforms_.assign(objects_.size(), {});
  for (std::size_t k = 0; k < objects_.size(); ++k) {
    Object& object = objects_[k];
    ObjectTransform transform;
    if (object.id != kWorldFrame) {
      const auto found = scene.objects.find(object.id);
      if (found == scene.objects.end()) continue;
      transform = seen_from(glm::vec3(0), object.id, found->second);
    }
    transforms_[k] = matrix_of(transform);
    Light light = shading_light(scene.light, transform);
    if (light == object.light) continue;
    object.light = std::move(light);
    relit[k] = 1;
    any_relit = true;
  }
  if (!any_relit || replica_.layout().appearance != Appearance::Transfer) return;
  const std::vector<std::uint32_t>& ids = replica_.shown_state().gaussians.object_id;
  std::uint32_t id = kWorldFrame, index = 0;
  for (std::size_t column = 0; column < ids.size(); ++column) {
    if (ids[column] != id) {
      id = ids[column];
      const auto found = index_of_object_.find(id);
      index = found != index_of_object_.end() ? found->second : kHidden;
    }
    if (index != kHidden && relit[index]) mark(row_of_column_[column], kColor);
  }
}

const std::vector<DisplayRows::Transform>& DisplayRows::transforms() {
  follow_scene();
  return transforms_;
}

void DisplayRows::find_rows(std::size_t most, Stale wanted, std::size_t& cursor,
                            std::vector<std::uint32_t>& rows) const {
  rows.clear();
  for (std::size_t seen = 0; rows.size() < most && seen < stale_.size(); ++seen, ++cursor) {
    if (cursor >= stale_.size()) cursor = 0;
    if (stale_[cursor] == wanted) rows.push_back(static_cast<std::uint32_t>(cursor));
  }
}

/// The colours of columns of what is shown.
class DisplayRows::Shader {
 public:
  explicit Shader(const DisplayRows& rows)
      : rows_(rows), state_(rows.replica_.shown_state()), maker_(state_.gaussians, state_.layout) {
    for (const LightSource& source : state_.scene.light.sources) {
      seen_.push_back(state_.light_rows.find(source.id));
    }
    visibility_.resize(1 + seen_.size());
  }

  [[nodiscard]] DisplayRecord record(std::size_t column, std::uint32_t object_index) {
    DisplayRecord out = maker_.record(column, object_index);
    out.color = color(column, object_index);
    return out;
  }
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
  const DisplayRows& rows_;
  const ReplicatedState& state_;
  RecordMaker maker_;
  std::vector<const Bytes*> seen_;  ///< of the scene's sources
  std::vector<float> visibility_;
};

void DisplayRows::take_records(std::size_t most, std::vector<std::uint32_t>& rows,
                               std::vector<DisplayRecord>& records) {
  find_columns();
  find_rows(std::min(most, unsent_), kRecord, record_cursor_, rows);
  const std::vector<std::uint32_t>& object_ids = replica_.shown_state().gaussians.object_id;
  // The scene is followed for all objects before there is a colour.
  for (const std::uint32_t row : rows) {
    if (column_of_row_[row] != kFree) static_cast<void>(index_of(object_ids[column_of_row_[row]]));
  }
  follow_scene();
  records.assign(rows.size(), {});
  Shader shader(*this);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    stale_[rows[k]] = kNothing;
    const std::uint32_t column = column_of_row_[rows[k]];
    const std::uint32_t object = column != kFree ? index_of(object_ids[column]) : kHidden;
    if (object != kHidden) records[k] = shader.record(column, object);
  }
  unsent_ -= rows.size();
}

void DisplayRows::take_colors(std::size_t most, std::vector<std::uint32_t>& rows, std::vector<std::uint32_t>& colors) {
  find_columns();
  follow_scene();
  find_rows(std::min(most, recolored_), kColor, color_cursor_, rows);
  const std::vector<std::uint32_t>& object_ids = replica_.shown_state().gaussians.object_id;
  colors.assign(rows.size(), 0);
  Shader shader(*this);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    stale_[rows[k]] = kNothing;
    const std::uint32_t column = column_of_row_[rows[k]];
    if (const std::uint32_t object = index_of(object_ids[column]); object != kHidden) {
      colors[k] = shader.color(column, object);
    }
  }
  recolored_ -= rows.size();
}

}  // namespace splatbus::stream
