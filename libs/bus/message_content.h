#pragma once

#include "bus/frames.h"
#include "bus/subscriber.h"

namespace splatbus::bus {

struct Message::Content {
  Frames frames;
};

}  // namespace splatbus::bus
