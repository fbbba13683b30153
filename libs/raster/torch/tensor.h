#pragma once

// What every header here needs of LibTorch. In this order: clang 14 does not get through LibTorch 1.13 in the other.
#include <ATen/core/ivalue.h>
#include <torch/types.h>
