#include "bench/roofline.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <stdexcept>

namespace splatbus::bench {
namespace {

Floor floor_of(const std::vector<Floor>& floors, const std::string& stage) {
  const auto found = std::find_if(floors.begin(), floors.end(), [&](const Floor& f) { return f.stage == stage; });
  if (found == floors.end()) throw std::runtime_error("no stage " + stage);
  return *found;
}

Job job_of(const ParameterLayout& layout) {
  Job job;
  job.layout = layout;
  job.census = {.gaussians = 1000,
                .views = 2,
                .pixels = 500,
                .listed_records = 1200,
                .listed_gaussians = 800,
                .pairs = 3000,
                .evaluations = 20000,
                .blended_records = 600,
                .blended_gaussians = 400,
                .blended_pairs = 900};
  return job;
}

const ParameterLayout kSh3{Appearance::Radiance, 3}, kSh0{Appearance::Radiance, 0}, kTransfer{Appearance::Transfer, 0};

TEST(Floors, ProjectionReadsAllMeansButTheRestOfWhatIsSeen) {
  const Floor floor = floor_of(cuda_floors(job_of(kSh3)), "project_and_list");
  EXPECT_DOUBLE_EQ(floor.bytes, 12 * 1000 + 56 * 4 * 800 + 36 * 1200 + 12 * 3000);
  EXPECT_DOUBLE_EQ(floor.operations, 10 * 2000 + 48 * 800 + (86 + 10 + 37 + 48 + 3) * 1200);
}

TEST(Floors, TransferReadsNormalsAndVisibility) {
  const Floor floor = floor_of(cuda_floors(job_of(kTransfer)), "project_and_list");
  EXPECT_DOUBLE_EQ(floor.bytes, 12 * 1000 + (38 + 4) * 4 * 800 + 36 * 1200 + 12 * 3000);
}

TEST(Floors, EveryPairIsSortedInOnePass) {
  EXPECT_DOUBLE_EQ(floor_of(cuda_floors(job_of(kSh3)), "sort").bytes, 16 * 3000);
  EXPECT_DOUBLE_EQ(floor_of(cpu_floors(job_of(kSh3)), "sort").bytes, 16 * 1200);
}

TEST(Floors, BlendingIsForWhatIsBlended) {
  const Floor floor = floor_of(cuda_floors(job_of(kSh3)), "blend_forward");
  EXPECT_DOUBLE_EQ(floor.bytes, 36 * 600 + 4 * 900 + 16 * 500);
  EXPECT_DOUBLE_EQ(floor.operations, (9 + 1 + 3 + 3) * 20000);
  // Without an instruction for it, an exponential is a polynomial.
  EXPECT_DOUBLE_EQ(floor_of(cpu_floors(job_of(kSh3)), "blend").operations, (9 + 8 + 3 + 3) * 20000);
}

TEST(Floors, AnAlbedoPictureHasThreeMorePlanes) {
  Job job = job_of(kTransfer);
  job.albedo = true;
  const Floor floor = floor_of(cuda_floors(job), "blend_forward");
  EXPECT_DOUBLE_EQ(floor.bytes, 48 * 600 + 4 * 900 + 28 * 500);
  EXPECT_DOUBLE_EQ(floor.operations, (9 + 1 + 3 + 6) * 20000);
  job.layout = kSh3;  // radiance has none
  EXPECT_DOUBLE_EQ(floor_of(cuda_floors(job), "blend_forward").operations, (9 + 1 + 3 + 3) * 20000);
}

TEST(Floors, TheLossReadsPictureAndTargetAndWritesAGradient) {
  EXPECT_DOUBLE_EQ(floor_of(cuda_floors(job_of(kSh3)), "loss").bytes, (12 + 4 + 12) * 500);
}

TEST(Floors, TensorCoresTakeTheSumsOfTheBackwardPass) {
  const double on_device = floor_of(cuda_floors(job_of(kSh3)), "blend_backward").operations;
  EXPECT_DOUBLE_EQ(on_device, (9 + 1 + 3 + 3 + 6) * 20000);
  const double on_host = floor_of(cpu_floors(job_of(kSh3)), "blend_backward").operations;
  EXPECT_DOUBLE_EQ(on_host, (9 + 8 + 3 + 3 + 6 + 8 + 3) * 20000);
}

TEST(Floors, TheUpdateReadsAndWritesWhatItTrainsOnce) {
  EXPECT_DOUBLE_EQ(floor_of(cuda_floors(job_of(kSh0)), "update").bytes, 36 * 600 + (24 * 14 + 8) * 400);
  Job job = job_of(kTransfer);
  job.active_channels = 14;
  EXPECT_DOUBLE_EQ(floor_of(cuda_floors(job), "update").bytes, 36 * 600 + (24 * 14 + 4 * 27 + 16 + 8) * 400);
}

TEST(Floors, SeparateAdamPaysForGradientsInMemory) {
  const std::vector<Floor> floors = cpu_floors(job_of(kSh0));
  EXPECT_DOUBLE_EQ(floor_of(floors, "project_backward").bytes, 36 * 600 + 12 * 14 * 400);
  EXPECT_DOUBLE_EQ(floor_of(floors, "adam").bytes, (28 * 14 + 8) * 400);
  EXPECT_DOUBLE_EQ(floor_of(floors, "clear").bytes, (9 + 4 * 14) * 1000);
  Job fused = job_of(kSh0);
  fused.fused = true;
  EXPECT_DOUBLE_EQ(floor_of(cpu_floors(fused), "clear").bytes, 9 * 1000);
}

TEST(Roofline, TheSlowerOfMemoryAndArithmeticBinds) {
  const Peaks peaks{.bytes_per_s = 1e9, .operations_per_s = 1e10};
  const std::vector<Floor> floors = {{"copies", 2e6, 1e6}, {"computes", 1e6, 4e7}, {"absent", 1, 1}};
  const nlohmann::json lines = roofline(floors, peaks, {{"copies", 3.0}, {"computes", 5.0}, {"unknown", 1.0}});
  EXPECT_EQ(lines.size(), 2);
  EXPECT_EQ(lines["copies"]["bound"], "memory");
  EXPECT_DOUBLE_EQ(lines["copies"]["floor_ms"], 2);
  EXPECT_DOUBLE_EQ(lines["copies"]["measured_ms"], 3);
  EXPECT_DOUBLE_EQ(lines["copies"]["times_floor"], 1.5);
  EXPECT_EQ(lines["computes"]["bound"], "compute");
  EXPECT_DOUBLE_EQ(lines["computes"]["floor_ms"], 4);
  EXPECT_DOUBLE_EQ(lines["computes"]["times_floor"], 1.25);
}

TEST(Roofline, NothingToDoHasNoMultiple) {
  const nlohmann::json lines = roofline({{"sort", 0, 0}}, {.bytes_per_s = 1, .operations_per_s = 1}, {{"sort", 0.5}});
  EXPECT_DOUBLE_EQ(lines["sort"]["times_floor"], 0);
}

TEST(Roofline, TheTableNamesEveryStage) {
  nlohmann::json result = {{"stages", {{"sort", 0.5}, {"new_stage", 1.25}}}};
  add_roofline({{"sort", 1e6, 0}}, {.bytes_per_s = 1e10, .operations_per_s = 1e10}, {}, result);
  const std::string table = roofline_table(result);
  EXPECT_NE(table.find("sort"), std::string::npos);
  EXPECT_NE(table.find("5.0  memory"), std::string::npos);
  EXPECT_NE(table.find("new_stage"), std::string::npos);
  EXPECT_NE(table.find("no floor is known"), std::string::npos);
}

}  // namespace
}  // namespace splatbus::bench
