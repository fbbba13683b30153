#include <cuda_runtime_api.h>

#include "stages.h"

namespace splatbus::bench {
namespace {

class CudaStages : public StagesTest {
 protected:
  void SetUp() override {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) GTEST_SKIP() << "no CUDA device";
    StagesTest::SetUp();
    arguments.backend = "cuda";
  }
};

TEST_F(CudaStages, OfTrainingHaveFloors) {
  arguments.batch = 2;
  const nlohmann::json result = run_cuda(arguments);
  expect_lines(result);
  // Lists are cut for footprints a little wider than what is counted, and one step earlier.
  const double pairs = result.at("work").at("pairs");
  EXPECT_NEAR(result.at("isects"), pairs, 0.1 * pairs);
}

TEST_F(CudaStages, OfTransferWithAlbedoHaveFloors) {
  arguments.appearance = "transfer";
  arguments.albedo_weight = 0.3F;
  expect_lines(run_cuda(arguments));
}

TEST_F(CudaStages, OfForwardHaveFloors) {
  arguments.mode = "forward";
  expect_lines(run_cuda(arguments));
}

}  // namespace
}  // namespace splatbus::bench
