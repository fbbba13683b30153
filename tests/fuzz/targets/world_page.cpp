// The payload of a page's record. The first byte chooses the layout.
#include "target.h"
#include "world/page_codec.h"

namespace world = splatbus::world;
using splatbus::fuzz::require;

SPLATBUS_FUZZ_TARGET(world_page, bytes) {
  splatbus::fuzz::Input input(bytes);
  splatbus::ParameterLayout layout;
  const auto choice = input.number();
  layout.appearance = choice % 2 == 0 ? splatbus::Appearance::Transfer : splatbus::Appearance::Radiance;
  layout.sh_degree = choice / 2 % 4;
  const auto payload = std::as_bytes(input.rest());
  try {
    const world::PageHeader header = world::read_page_header(payload, layout, "fuzz");
    const world::Page page = world::decode_page(payload, layout, {}, "fuzz");
    require(page.count == header.count && page.words.size() == std::size_t{header.rows} * header.count, "whole");
  } catch (const world::WorldError&) {  // refused
  }
}
