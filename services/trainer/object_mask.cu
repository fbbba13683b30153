#include "device/parallel.h"
#include "trainer/object_mask.h"

namespace splatbus::trainer {

namespace {

struct MaskPixel {
  const std::uint32_t* object_id;
  const std::uint32_t* ids;
  std::uint32_t id_count;
  std::uint8_t* mask;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t id = object_id[i];
    std::uint32_t first = 0, end = id_count;
    while (first < end) {
      const std::uint32_t middle = first + (end - first) / 2;
      ids[middle] < id ? first = middle + 1 : end = middle;
    }
    mask[i] = first < id_count && ids[first] == id ? 255 : 0;
  }
};

}  // namespace

void mask_objects(device::StreamView stream, const std::uint32_t* object_id, std::uint32_t pixels,
                  const std::uint32_t* ids, std::uint32_t id_count, std::uint8_t* mask) {
  device::for_each_index(stream, pixels, MaskPixel{object_id, ids, id_count, mask});
}

}  // namespace splatbus::trainer
