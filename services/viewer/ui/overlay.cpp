#include "viewer/ui/overlay.h"

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>
#include <backends/imgui_impl_glfw.h>
#include <backends/imgui_impl_opengl3.h>
#include <imgui.h>

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <deque>
#include <vector>

#include "viewer/ui/menu.h"

namespace splatbus::viewer {
namespace {

constexpr float kFontPixels = 13;  // of ImGui's own font, which is sharp at its multiples
constexpr float kRepeatDelay_s = 0.25F;
constexpr ImGuiWindowFlags kPanel = ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoInputs | ImGuiWindowFlags_NoNav |
                                    ImGuiWindowFlags_AlwaysAutoResize | ImGuiWindowFlags_NoFocusOnAppearing |
                                    ImGuiWindowFlags_NoBringToFrontOnFocus;

void draw_figures(const OverlayContent& content) {
  ImGui::SetNextWindowPos({kPanelMargin, kPanelMargin});
  ImGui::SetNextWindowBgAlpha(0.75F);
  ImGui::Begin("figures", nullptr, kPanel);
  if (ImGui::BeginTable("rows", 2, ImGuiTableFlags_SizingFixedFit)) {
    for (const auto& [name, value] : content.figures) {
      ImGui::TableNextColumn();
      ImGui::TextUnformatted(name.c_str());
      ImGui::TableNextColumn();
      ImGui::TextUnformatted(value.c_str());
    }
    ImGui::EndTable();
  }
  ImGui::End();
}

void draw_notice(const std::string& text) {
  const ImVec2 size = ImGui::GetIO().DisplaySize;
  ImGui::SetNextWindowPos({size.x / 2, size.y - kPanelMargin}, ImGuiCond_Always, {0.5F, 1});
  ImGui::SetNextWindowBgAlpha(0.85F);
  ImGui::Begin("notice", nullptr, kPanel);
  ImGui::TextUnformatted(text.c_str());
  ImGui::End();
}

class ImGuiOverlay final : public Overlay {
 public:
  explicit ImGuiOverlay(GLFWwindow* window) : window_(window) {
    IMGUI_CHECKVERSION();
    ImGui::CreateContext();
    ImGuiIO& io = ImGui::GetIO();
    io.IniFilename = nullptr;  // no file in whatever folder this is
    io.ConfigFlags |= ImGuiConfigFlags_NavEnableKeyboard;
    ImGui::StyleColorsDark();
    float scale = 1, unused = 1;
    glfwGetWindowContentScale(window, &scale, &unused);
    scale = std::max(1.0F, std::round(scale));
    ImGui::GetStyle().ScaleAllSizes(scale);
    ImFontConfig font;
    font.SizePixels = kFontPixels * scale;
    io.Fonts->AddFontDefault(&font);
    ImGui_ImplGlfw_InitForOpenGL(window, true);
    ImGui_ImplOpenGL3_Init("#version 330 core");
  }
  ~ImGuiOverlay() override {
    ImGui_ImplOpenGL3_Shutdown();
    ImGui_ImplGlfw_Shutdown();
    ImGui::DestroyContext();
  }

  std::vector<Action> draw(OverlayContent& content) override {
    pass_keys();
    // A key is held for a picture more while others wait for theirs: that is no repetition.
    ImGui::GetIO().KeyRepeatDelay = keys_.empty() ? kRepeatDelay_s : FLT_MAX;
    ImGui_ImplOpenGL3_NewFrame();
    ImGui_ImplGlfw_NewFrame();
    ImGui::NewFrame();
    std::vector<Action> actions;
    if (!content.figures.empty()) draw_figures(content);
    if (content.menu) menu_ = draw_menu(content, actions);
    if (!content.notice.empty()) draw_notice(content.notice);
    shown_ = content.menu;
    ImGui::Render();
    ImGui_ImplOpenGL3_RenderDrawData(ImGui::GetDrawData());
    return actions;
  }

  void key(int key, int scancode, int action, int mods) override {
    if (action == GLFW_REPEAT) return;  // ImGui repeats by itself
    keys_.push_back({key, scancode, action, mods});
    if (!shown_) pass_keys();
  }
  bool has_keys() const override { return shown_ && !keys_.empty(); }

  // By the place: ImGui's own WantCaptureMouse is of where the mouse was when it was last drawn.
  bool wants_mouse() const override {
    double x = 0, y = 0;
    glfwGetCursorPos(window_, &x, &y);
    return shown_ && (menu_.contains(static_cast<float>(x), static_cast<float>(y)) || chooses());
  }
  bool wants_keyboard() const override { return shown_ && ImGui::GetIO().WantCaptureKeyboard; }
  bool chooses() const override {
    return shown_ && ImGui::IsPopupOpen("", ImGuiPopupFlags_AnyPopupId | ImGuiPopupFlags_AnyPopupLevel);
  }

 private:
  struct Key {
    int key, scancode, action, mods;
  };
  // ImGui sees keys as they are when it is drawn: a picture shows one press and one change of each key, however many
  // came before it.
  void pass_keys() {
    std::vector<int> changed;
    while (!keys_.empty() && std::ranges::find(changed, keys_.front().key) == changed.end()) {
      const Key now = keys_.front();
      keys_.pop_front();
      ImGui_ImplGlfw_KeyCallback(window_, now.key, now.scancode, now.action, now.mods);
      if (!shown_) continue;
      if (now.action == GLFW_PRESS) break;
      changed.push_back(now.key);
    }
  }

  GLFWwindow* window_;
  MenuPlace menu_;
  bool shown_ = false;  ///< the menu
  std::deque<Key> keys_;
};

}  // namespace

std::unique_ptr<Overlay> make_overlay(GLFWwindow* window) {
  return std::make_unique<ImGuiOverlay>(window);
}

}  // namespace splatbus::viewer
