#include "world/world.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <stdexcept>
#include <vector>

#include "schema_json.h"
#include "splat_options.h"
#include "splats/file.h"
#include "verbs.h"
#include "world/gathered_model.h"

namespace splatbus::cli {

namespace {

struct WorldVerbOptions {
  std::string folder, path;
  std::vector<double> beyond;  ///< x, y, z, radius in metres
  double max_mb = 0;
  splats::WriteOptions write;
  bool json = false;
};

struct Totals {
  std::uint64_t gaussians = 0, bytes = 0, frozen = 0, spilled = 0;
  PageBounds bounds;  ///< of what stands still
};

Totals totals_of(const world::World& folder) {
  Totals totals;
  for (const auto& [key, page] : folder.pages()) {
    totals.gaussians += page.count;
    totals.bytes += page.bytes;
    totals.frozen += page.state == model::PageState::Frozen ? page.count : 0;
    totals.spilled += page.mark == world::PageMark::Spilled ? page.count : 0;
    if (key.frame_id != kWorldFrame) continue;
    include(totals.bounds, page.bounds.low);
    include(totals.bounds, page.bounds.high);
  }
  return totals;
}

int info(const WorldVerbOptions& options) {
  const world::World folder{std::filesystem::path(options.folder)};
  const Totals totals = totals_of(folder);
  const world::WorldProgress progress = folder.progress();
  const PageBounds& bounds = totals.bounds;
  if (options.json) {
    std::vector<std::string> damage;
    for (const world::Damage& place : folder.damage()) damage.push_back(place.text());
    nlohmann::json box;
    if (bounds.low.x <= bounds.high.x) {
      box = {{"low_m", {bounds.low.x, bounds.low.y, bounds.low.z}},
             {"high_m", {bounds.high.x, bounds.high.y, bounds.high.z}}};
    }
    fmt::print("{}\n", json_text({{"pages", folder.pages().size()},
                                  {"gaussians", totals.gaussians},
                                  {"frozen", totals.frozen},
                                  {"spilled", totals.spilled},
                                  {"bytes", folder.bytes()},
                                  {"live_bytes", totals.bytes},
                                  {"segments", folder.segments()},
                                  {"step", progress.step},
                                  {"optimizer_s", progress.optimizer_s},
                                  {"next_gaussian_id", progress.next_gaussian_id},
                                  {"epoch", folder.manifest().epoch},
                                  {"note", folder.manifest().note},
                                  {"bounds", box},
                                  {"lost_pages", folder.lost().size()},
                                  {"damage", damage}}));
    return 0;
  }
  fmt::print("{} Gaussians in {} pages, {} of them frozen, {} on disk only\n", totals.gaussians, folder.pages().size(),
             totals.frozen, totals.spilled);
  fmt::print("{:.1f} MB in {} segments, of which {:.1f} MB count\n", static_cast<double>(folder.bytes()) / 1e6,
             folder.segments(), static_cast<double>(totals.bytes) / 1e6);
  fmt::print("step {}, {:.1f} s of optimizer time, opened {} times\n", progress.step, progress.optimizer_s,
             folder.manifest().epoch);
  if (bounds.low.x <= bounds.high.x) {
    fmt::print("from {:.2f} {:.2f} {:.2f} to {:.2f} {:.2f} {:.2f} m\n", bounds.low.x, bounds.low.y, bounds.low.z,
               bounds.high.x, bounds.high.y, bounds.high.z);
  }
  if (!folder.manifest().note.empty()) fmt::print("note: {}\n", folder.manifest().note);
  for (const world::Damage& place : folder.damage()) fmt::print("damage: {}\n", place.text());
  if (!folder.lost().empty()) fmt::print("{} pages are lost by it\n", folder.lost().size());
  return 0;
}

int export_world(const WorldVerbOptions& options) {
  world::World folder{std::filesystem::path(options.folder)};
  const GaussiansBuffer model = world::gather_model(folder).gaussians;
  // A folder has no light: white from everywhere, under which a surface shows its albedo.
  SceneState scene;
  constexpr float kUniform = 3.5449077F;  // sqrt(4 pi): radiance 1
  scene.light.ambient_sh[0] = glm::vec3(kUniform);
  // Nor does it know where objects are: each is shown where its own frame has it.
  for (const std::uint32_t id : model.object_id) {
    if (id != kWorldFrame && id != kFarFieldFrame) scene.objects.try_emplace(id);
  }
  print_written(options.path, splats::write_file(options.path, model.view(), scene, options.write), options.json);
  return 0;
}

/// Of the middle of a page, from a point of the world; pages of objects are where their object is, which a folder does
/// not know, and count as near.
double distance_m(const world::PageKey& key, const world::PageEntry& page, const std::vector<double>& point) {
  if (key.frame_id != kWorldFrame) return 0;
  const auto middle = [](float low, float high) { return 0.5 * (double{low} + double{high}); };
  return std::hypot(middle(page.bounds.low.x, page.bounds.high.x) - point[0],
                    middle(page.bounds.low.y, page.bounds.high.y) - point[1],
                    middle(page.bounds.low.z, page.bounds.high.z) - point[2]);
}

int prune(const WorldVerbOptions& options) {
  if (options.beyond.empty() && options.max_mb <= 0) throw std::runtime_error("give --max-mb or --beyond");
  const world::World before{std::filesystem::path(options.folder)};
  world::World folder(options.folder, {.layout = before.layout()});
  std::vector<std::pair<world::PageKey, world::PageEntry>> pages;
  std::uint64_t bytes = 0, gone = 0;
  for (const auto& page : folder.pages()) {
    pages.emplace_back(page);
    bytes += page.second.bytes;
  }
  const auto drop = [&](const auto& page) {
    folder.remove(page.first);
    bytes -= page.second.bytes;
    gone += page.second.count;
  };
  if (!options.beyond.empty()) {
    std::erase_if(pages, [&](const auto& page) {
      const bool beyond = distance_m(page.first, page.second, options.beyond) > options.beyond[3];
      if (beyond) drop(page);
      return beyond;
    });
  }
  if (options.max_mb > 0) {
    // Those that nothing has taught for the longest time.
    std::sort(pages.begin(), pages.end(), [](const auto& a, const auto& b) { return a.second.step < b.second.step; });
    for (auto page = pages.begin(); page != pages.end() && static_cast<double>(bytes) > options.max_mb * 1e6; ++page) {
      drop(*page);
    }
  }
  if (gone > 0) folder.commit(folder.progress());
  for (std::uint64_t size = folder.bytes(); folder.compact(true) && folder.bytes() < size;) size = folder.bytes();
  if (options.json) {
    fmt::print("{}\n", json_text({{"removed", gone}, {"live_bytes", bytes}, {"bytes", folder.bytes()}}));
  } else {
    fmt::print("{} Gaussians removed, {:.1f} MB left\n", gone, static_cast<double>(folder.bytes()) / 1e6);
  }
  return 0;
}

}  // namespace

void add_world_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<WorldVerbOptions>();
  CLI::App* world = app.add_subcommand("world", "Inspect and change a world folder, which keeps a model across runs");
  world->require_subcommand(1);
  const auto add = [&](const char* name, const char* description, int (*run)(const WorldVerbOptions&)) {
    CLI::App* verb = world->add_subcommand(name, description);
    verb->add_option("folder", options->folder, "world folder")->required();
    verb->add_flag("--json", options->json, "print the result as JSON");
    verb->callback([options, run, &action] { action = [options, run] { return run(*options); }; });
    return verb;
  };
  add("info", "Print what the folder holds and what is damaged", info);
  CLI::App* verb = add("export", "Write the model under white light to a file for splat tools", export_world);
  verb->add_option("file", options->path, "file to write (.ply, .glb, .spz)")->required();
  add_write_options(*verb, options->write);
  verb = add("prune", "Delete pages for good; no trainer may use the folder meanwhile", prune);
  verb->add_option("--max-mb", options->max_mb, "delete pages until this many MB are left, longest untrained first")
      ->check(CLI::PositiveNumber);
  verb->add_option("--beyond", options->beyond, "x,y,z,r: delete pages farther than r metres from that point")
      ->delimiter(',')
      ->expected(4);
}

}  // namespace splatbus::cli
