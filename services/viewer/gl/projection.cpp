#include "viewer/gl/projection.h"

#include <algorithm>
#include <array>
#include <cstddef>

#include "gl/program.h"
#include "viewer/gl/shaders.h"
#include "viewer/gl/steps.h"

namespace splatbus::viewer::gl {
namespace {

constexpr std::size_t kSplatBytes = 32;

/// view_from_world, row-major [3][4].
std::array<double, 12> view_of(const Camera& camera) {
  const Rigid view = inverse(camera.world_from_camera);
  const glm::dmat3 rotation = glm::mat3_cast(glm::dquat(view.rotation));
  std::array<double, 12> out{};
  auto to = out.begin();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) *to++ = rotation[column][row];
    *to++ = view.translation[row];
  }
  return out;
}

bool is_hidden(const Transform& transform) {
  return std::all_of(transform.begin(), transform.end(), [](float value) { return value == 0; });
}

/// 0.3 of the half field of view beyond the picture's sides: left, right, top, bottom, as tangents.
glm::vec4 tangent_limits(const Camera& camera) {
  const auto width = static_cast<float>(camera.width), height = static_cast<float>(camera.height);
  const float x = 0.15F * width / camera.fx, y = 0.15F * height / camera.fy;
  return {-camera.cx / camera.fx - x, (width - camera.cx) / camera.fx + x, -camera.cy / camera.fy - y,
          (height - camera.cy) / camera.fy + y};
}

}  // namespace

Projection::Projection()
    : project_(make_compute_program(kProjectText)),
      count_seen_(make_compute_program(kCountSeenText)),
      close_up_(make_compute_program(kCloseUpText)),
      objects_(make_buffer()),
      seen_(make_words(sizeof(Seen) / kWord)) {
  glClearNamedBufferData(seen_.get(), GL_R32UI, GL_RED_INTEGER, GL_UNSIGNED_INT, nullptr);
}

void Projection::reserve(std::size_t capacity) {
  if (capacity <= capacity_) return;
  capacity_ = capacity;
  splats_ = make_words(capacity * kSplatBytes / kWord);
  keys_ = make_words(capacity);
  group_counts_ = make_words(groups_of(capacity, kThreads));
  depth_sort_.reserve(capacity);
  for (Keyed* keyed : {&sorted_, &other_}) *keyed = make_keyed(capacity);
}

void Projection::upload_objects(const Frame& frame) {
  const std::array<double, 12> view = view_of(frame.camera);
  camera_from_objects_.assign(12 * std::max<std::size_t>(frame.transforms.size(), 1), 0);
  for (std::size_t object = 0; object < frame.transforms.size(); ++object) {
    const Transform& transform = frame.transforms[object];
    if (is_hidden(transform)) continue;  // all in the eye, where nothing is seen
    const bool fixed = frame.far_field == 0 || object != frame.far_field;
    for (std::size_t row = 0; row < 3; ++row) {
      for (std::size_t column = 0; column < 4; ++column) {
        double sum = column == 3 && fixed ? view[4 * row + 3] : 0;
        for (std::size_t k = 0; k < 3; ++k) sum += view[4 * row + k] * double{transform[4 * k + column]};
        camera_from_objects_[12 * object + 4 * row + column] = static_cast<float>(sum);
      }
    }
  }
  glNamedBufferData(objects_.get(), static_cast<GLsizeiptr>(camera_from_objects_.size() * sizeof(float)),
                    camera_from_objects_.data(), GL_STREAM_DRAW);
}

void Projection::run(const RowStore& rows, const Frame& frame, FrameTimer& timer) {
  reserve(rows.capacity());
  upload_objects(frame);
  next_step();  // and the last picture has read what is written now
  project(rows, frame);
  timer.mark(FrameTimer::kProjected);
  sort(rows.used());
  timer.mark(FrameTimer::kSorted);
}

void Projection::project(const RowStore& rows, const Frame& frame) {
  const Camera& camera = frame.camera;
  bind_buffers({rows.records(), rows.fades(), rows.harmonics(), objects_.get(), splats_.get(), keys_.get(),
                group_counts_.get(), rows.kept()});
  glUseProgram(project_.get());
  glUniform1ui(kRows, static_cast<GLuint>(rows.used()));
  glUniform4f(kPinhole, camera.fx, camera.fy, camera.cx, camera.cy);
  glUniform2f(kSize, static_cast<float>(camera.width), static_cast<float>(camera.height));
  const glm::vec4 limits = tangent_limits(camera);
  glUniform4f(kTangents, limits.x, limits.y, limits.z, limits.w);
  glUniform1f(kTime, frame.time_s);
  glUniform1i(kAntialias, frame.antialias ? GL_TRUE : GL_FALSE);
  glUniform1ui(kHarmonicWords, static_cast<GLuint>(rows.harmonic_words()));
  glUniform1f(kColorPart, frame.color_part);
  glUniform1f(kNear, std::max(camera.near_m, 0.0F));
  if (rows.used() > 0) glDispatchCompute(groups_of(rows.used(), kThreads), 1, 1);
  next_step();
}

void Projection::sort(std::size_t rows) {
  bind_buffers({group_counts_.get(), seen_.get()});
  glUseProgram(count_seen_.get());
  glUniform1ui(kRows, static_cast<GLuint>(rows));
  glDispatchCompute(1, 1, 1);
  next_step();
  if (rows == 0) return;
  bind_buffers({keys_.get(), group_counts_.get(), sorted_.keys.get(), sorted_.rows.get()});
  glUseProgram(close_up_.get());
  glUniform1ui(kRows, static_cast<GLuint>(rows));
  glDispatchCompute(groups_of(rows, kThreads), 1, 1);
  next_step();
  depth_sort_.run(seen_.get(), sorted_, other_, kKeyBits);
}

void Projection::bind() const {
  bind_buffers({seen_.get(), sorted_.rows.get(), splats_.get()});
}

std::size_t Projection::count_seen() const {
  GLuint rows = 0;
  glMemoryBarrier(GL_BUFFER_UPDATE_BARRIER_BIT);
  glGetNamedBufferSubData(seen_.get(), offsetof(Seen, counted.rows), kWord, &rows);
  return rows;
}

}  // namespace splatbus::viewer::gl
