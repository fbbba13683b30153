#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "topic_verbs.h"

namespace splatbus::cli {
namespace {

TopicSnapshot snapshot() {
  TopicSnapshot now;
  now.topics["engine/frame"] = {.sources = {"engine"}, .subscribers = {"capture-bridge", "pid 17"}};
  now.topics["viewer/pose"] = {.sources = {"viewer-1", "viewer-2"}};
  now.topics["odd\"name\\"] = {.sources = {"engine"}, .subscribers = {"odd\"name\\"}};
  return now;
}

TEST(Graph, IsOneLineATopicAsText) {
  EXPECT_EQ(graph_text({}, snapshot(), false),
            "engine -> engine/frame -> capture-bridge, pid 17\n"
            "engine -> odd\"name\\ -> odd\"name\\\n"
            "viewer-1, viewer-2 -> viewer/pose -> nobody\n");
  TopicOptions poses;
  poses.topics = {"viewer/*", "none"};
  EXPECT_EQ(graph_text(poses, snapshot(), false), "viewer-1, viewer-2 -> viewer/pose -> nobody\n");
}

TEST(Graph, QuotesNamesInDot) {
  TopicOptions options;
  options.topics = {"engine/frame", "odd*"};
  EXPECT_EQ(graph_text(options, snapshot(), true),
            "digraph splatbus {\n"
            "  rankdir=LR;\n"
            "  \"/engine/frame\" [shape=box];\n"
            "  \"engine\" -> \"/engine/frame\";\n"
            "  \"/engine/frame\" -> \"capture-bridge\";\n"
            "  \"/engine/frame\" -> \"pid 17\";\n"
            "  \"/odd\\\"name\\\\\" [shape=box];\n"
            "  \"engine\" -> \"/odd\\\"name\\\\\";\n"
            "  \"/odd\\\"name\\\\\" -> \"odd\\\"name\\\\\";\n"
            "}\n");
}

TEST(Topics, AreAskedForByNameOrPrefix) {
  TopicOptions options;
  EXPECT_TRUE(is_asked_for(options, "sys/log")) << "all, when none is named";
  options.topics = {"viewer/*", "sys/log"};
  EXPECT_TRUE(is_asked_for(options, "viewer/pose"));
  EXPECT_TRUE(is_asked_for(options, "sys/log"));
  EXPECT_FALSE(is_asked_for(options, "sys/logs"));
  EXPECT_FALSE(is_asked_for(options, "my/viewer/pose"));
}

}  // namespace
}  // namespace splatbus::cli
