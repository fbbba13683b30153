#include "stages.h"

namespace splatbus::bench {
namespace {

using Stages = StagesTest;

TEST_F(Stages, OfTrainingWithAdamInTheBackwardPassHaveFloors) {
  expect_lines(run_cpu(arguments));
}

TEST_F(Stages, OfTrainingABatchHaveFloors) {
  arguments.batch = 2;
  expect_lines(run_cpu(arguments));
}

TEST_F(Stages, OfTransferHaveFloors) {
  arguments.appearance = "transfer";
  expect_lines(run_cpu(arguments));
}

TEST_F(Stages, OfForwardHaveFloors) {
  arguments.mode = "forward";
  expect_lines(run_cpu(arguments));
}

}  // namespace
}  // namespace splatbus::bench
