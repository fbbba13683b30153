#include "viewer/gl/tiles.h"

#include <algorithm>
#include <bit>

#include "gl/program.h"
#include "viewer/gl/shaders.h"
#include "viewer/gl/steps.h"

namespace splatbus::viewer::gl {
namespace {

constexpr std::size_t kLeastPairs = 1 << 14;
constexpr std::size_t kPairsARow = 2;  // to begin with: most splats are small
static_assert(Tiles::kMostPairs < kMostCounted);

}  // namespace

Tiles::Tiles(std::size_t most_pairs)
    : count_tiles_(make_compute_program(kCountTilesText)),
      count_pairs_(make_compute_program(kCountPairsText)),
      pair_(make_compute_program(kPairText)),
      ranges_program_(make_compute_program(kRangesText)),
      blend_(make_compute_program(kBlendText)),
      pairs_(make_words(sizeof(Pairs) / kWord)),
      wanted_(make_buffer()),
      most_pairs_(std::min(most_pairs, kMostPairs)) {
  constexpr GLbitfield kHow = GL_MAP_READ_BIT | GL_MAP_PERSISTENT_BIT | GL_MAP_COHERENT_BIT;
  constexpr auto kBytes = static_cast<GLsizeiptr>(kPictures * kWord);
  glNamedBufferStorage(wanted_.get(), kBytes, nullptr, kHow);
  wanted_here_ = static_cast<const std::uint32_t*>(glMapNamedBufferRange(wanted_.get(), 0, kBytes, kHow));
}

Tiles::~Tiles() {
  for (const Asked& asked : asked_) {
    if (asked.done) glDeleteSync(asked.done);
  }
}

void Tiles::reserve_rows(std::size_t rows) {
  if (rows <= rows_) return;
  rows_ = rows;
  tile_counts_ = make_words(rows);
  group_counts_ = make_words(groups_of(rows, kThreads));
  reserve_pairs(kPairsARow * rows);
}

void Tiles::reserve_pairs(std::size_t pairs) {
  pairs = std::min(std::max(pairs, kLeastPairs), most_pairs_);
  if (pairs <= capacity_) return;
  capacity_ = pairs;
  for (Keyed* keyed : {&sorted_, &other_}) *keyed = make_keyed(pairs);
  tile_sort_.reserve(pairs);
}

void Tiles::reserve_tiles(std::size_t tiles) {
  if (tiles <= tiles_) return;
  tiles_ = tiles;
  ranges_ = make_words(2 * (tiles + 1));
}

void Tiles::release() {
  if (capacity_ == 0) return;
  for (GlBuffer* buffer : {&tile_counts_, &group_counts_, &ranges_}) *buffer = {};
  for (Keyed* keyed : {&sorted_, &other_}) *keyed = {};
  rows_ = capacity_ = tiles_ = 0;
}

void Tiles::list(const Projection& projection, std::size_t rows, std::uint32_t width, std::uint32_t height,
                 FrameTimer& timer) {
  width_ = width;
  height_ = height;
  const GLuint across = groups_of(width, kTileSide), down = groups_of(height, kTileSide);
  reserve_rows(std::max<std::size_t>(rows, 1));
  reserve_tiles(std::size_t{across} * down);
  bind_buffers({projection.seen(), projection.order(), projection.splats(), tile_counts_.get(), group_counts_.get()});
  glUseProgram(count_tiles_.get());
  glUniform2ui(kPixels, width, height);
  dispatch_indirect(projection.seen(), offsetof(Seen, row_groups));
  next_step();
  bind_buffers({group_counts_.get(), projection.seen(), pairs_.get(), ranges_.get()});
  glUseProgram(count_pairs_.get());
  glUniform2ui(kTiles, across, down);
  glUniform1ui(kCapacity, static_cast<GLuint>(capacity_));
  glDispatchCompute(1, 1, 1);
  next_step();
  bind_buffers({projection.seen(), projection.order(), projection.splats(), tile_counts_.get(), group_counts_.get(),
                sorted_.keys.get(), sorted_.rows.get()});
  glUseProgram(pair_.get());
  glUniform2ui(kPixels, width, height);
  glUniform2ui(kTiles, across, down);
  dispatch_indirect(pairs_.get(), offsetof(Pairs, row_groups));
  next_step();
  timer.mark(FrameTimer::kPaired);
  tile_sort_.run(pairs_.get(), sorted_, other_, static_cast<unsigned>(std::bit_width(across * down)));
  bind_buffers({pairs_.get(), sorted_.keys.get(), ranges_.get()});
  glUseProgram(ranges_program_.get());
  dispatch_indirect(pairs_.get(), offsetof(Pairs, counted.groups));
  next_step();
  timer.mark(FrameTimer::kTilesSorted);
  ask();
}

void Tiles::blend(const Projection& projection, GLuint picture) {
  bind_buffers({ranges_.get(), sorted_.rows.get(), projection.splats()});
  glBindImageTexture(0, picture, 0, GL_FALSE, 0, GL_WRITE_ONLY, GL_RGBA16F);
  glMemoryBarrier(GL_SHADER_IMAGE_ACCESS_BARRIER_BIT);  // the last picture has been read
  glUseProgram(blend_.get());
  glUniform2ui(kPixels, width_, height_);
  glDispatchCompute(groups_of(width_, kTileSide), groups_of(height_, kTileSide), 1);
  glMemoryBarrier(GL_TEXTURE_FETCH_BARRIER_BIT | GL_FRAMEBUFFER_BARRIER_BIT);
}

void Tiles::ask() {
  if (begun_ - taken_ == kPictures) return;
  const std::size_t slot = begun_++ % kPictures;
  glMemoryBarrier(GL_BUFFER_UPDATE_BARRIER_BIT);
  glCopyNamedBufferSubData(pairs_.get(), wanted_.get(), offsetof(Pairs, wanted), static_cast<GLintptr>(slot * kWord),
                           kWord);
  asked_[slot] = {glFenceSync(GL_SYNC_GPU_COMMANDS_COMPLETE, 0), capacity_};
}

std::optional<Tiles::Listed> Tiles::take() {
  if (taken_ == begun_) return std::nullopt;
  const std::size_t slot = taken_ % kPictures;
  Asked& asked = asked_[slot];
  const GLenum state = glClientWaitSync(asked.done, 0, 0);
  if (state != GL_ALREADY_SIGNALED && state != GL_CONDITION_SATISFIED) return std::nullopt;
  glDeleteSync(asked.done);
  asked.done = nullptr;
  ++taken_;
  Listed listed{.pairs = wanted_here_[slot], .fitted = wanted_here_[slot] <= asked.capacity};
  if (!listed.fitted && capacity_ > 0) {
    const std::size_t before = capacity_;
    reserve_pairs(listed.pairs + listed.pairs / 4);
    listed.grown = capacity_ > before;
  }
  return listed;
}

}  // namespace splatbus::viewer::gl
