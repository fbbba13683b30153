#include "wire/schemas.h"

#include <flatbuffers/reflection_generated.h>

#include <algorithm>
#include <array>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include "wire/sampling_topics.h"
#include "wire/share_topics.h"
#include "wire/topics.h"
#include "wire/trace_topics.h"

namespace splatbus::wire {

namespace {

constexpr std::array kSchemas{kSchema<CaptureInput>,      kSchema<CaptureProbe>,
                              kSchema<CaptureReference>,  kSchema<Control>,
                              kSchema<EngineCameras>,     kSchema<EngineFrame>,
                              kSchema<GridState>,         kSchema<Heartbeat>,
                              kSchema<Liveness>,          kSchema<Log>,
                              kSchema<ModelInsert>,       kSchema<ModelPublished>,
                              kSchema<RelightVisibility>, kSchema<SceneLightDepth>,
                              kSchema<SceneUpdate>,       kSchema<StreamStats>,
                              kSchema<StreamerOffer>,     kSchema<Topics>,
                              kSchema<TrainerStats>,      kSchema<ViewerPose>,
                              kSchema<ViewerProbe>,       kSchema<ViewerQuality>,
                              kSchema<StreamShare>,       kSchema<SamplingOffer>,
                              kSchema<SamplingResult>,    kSchema<SamplingRound>};
/// A family before those that include it, so that a table's schema says no more than it has to.
constexpr std::array<std::string_view, 10> kFamilies{"engine", "scene",  "capture", "model", "viewer",
                                                     "system", "stream", "trace",   "share", "sampling"};

/// By family, "system", or file, "foxglove/Log".
const std::map<std::string_view, std::vector<std::uint8_t>>& files() {
  static const std::map<std::string_view, std::vector<std::uint8_t>> all{
#include "wire/embedded_schemas.inc"
  };
  return all;
}

/// As the file itself has the name, whose bytes stay.
std::optional<TableSchema> find_in(std::string_view file, const std::string& table) {
  const auto found = files().find(file);
  if (found == files().end()) return std::nullopt;
  const auto* object = reflection::GetSchema(found->second.data())->objects()->LookupByKey(table.c_str());
  if (object == nullptr) return std::nullopt;
  return TableSchema{object->name()->string_view(), found->second};
}

}  // namespace

std::optional<TableSchema> find_schema(std::string_view header_schema) {
  if (std::find(kSchemas.begin(), kSchemas.end(), header_schema) == kSchemas.end()) return std::nullopt;
  const std::string table = "splatbus.wire." + std::string(header_schema.substr(0, header_schema.find('/')));
  for (const std::string_view family : kFamilies) {
    if (auto found = find_in(family, table)) return found;
  }
  return std::nullopt;
}

TableSchema foxglove_schema(std::string_view table) {
  const std::string name(table);
  const auto found = find_in("foxglove/" + name.substr(name.find('.') + 1), name);
  if (!found) throw std::out_of_range(name + ": not a schema of schemas/foxglove");
  return *found;
}

}  // namespace splatbus::wire
