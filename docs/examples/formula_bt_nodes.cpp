// Nodes of BehaviorTree.CPP 4 over formulas, as a plugin of Nav2 for ROS 2 Jazzy.
// docs/behaviour_trees.md explains them.

#include <chrono>
#include <memory>
#include <string>

#include "behaviortree_cpp/bt_factory.h"
#include "behaviortree_cpp/condition_node.h"
#include "dyknow_interfaces/action/monitor_formula.hpp"
#include "dyknow_interfaces/msg/exit_status.hpp"
#include "dyknow_interfaces/msg/formula_result.hpp"
#include "dyknow_interfaces/msg/formula_verdict.hpp"
#include "nav2_behavior_tree/bt_action_node.hpp"
#include "rclcpp/rclcpp.hpp"

namespace formula_bt_nodes
{
using dyknow_interfaces::action::MonitorFormula;
using dyknow_interfaces::msg::ExitStatus;
using dyknow_interfaces::msg::FormulaResult;
using dyknow_interfaces::msg::FormulaVerdict;
using Clock = std::chrono::steady_clock;

/// SUCCESS: the formula is not violated; FAILURE: it is, or it is unknown.
class FormulaHolds : public BT::ConditionNode
{
public:
  FormulaHolds(const std::string & name, const BT::NodeConfig & config)
  : BT::ConditionNode(name, config)
  {
    node_ = config.blackboard->get<rclcpp::Node::SharedPtr>("node");
    group_ = node_->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false);
    executor_.add_callback_group(group_, node_->get_node_base_interface());
    rclcpp::SubscriptionOptions options;
    options.callback_group = group_;
    subscription_ = node_->create_subscription<FormulaVerdict>(
      getInput<std::string>("topic").value(), rclcpp::QoS(1).transient_local(),
      [this](FormulaVerdict::ConstSharedPtr verdict) {
        verdict_ = verdict;
        received_ = Clock::now();
      },
      options);
  }

  static BT::PortsList providedPorts()
  {
    return {
      BT::InputPort<std::string>("topic", "of the verdicts of the formula"),
      BT::InputPort<double>("max_age", 2.5, "seconds; verdicts come each second"),
      BT::InputPort<double>(
        "max_state_age", 5.0, "seconds; more for a topic that is published rarely")};
  }

  BT::NodeStatus tick() override
  {
    executor_.spin_some();
    const std::chrono::duration<double> max_age(getInput<double>("max_age").value());
    const bool holds = verdict_ && !verdict_->is_violated &&
      verdict_->exit_status.code == ExitStatus::SUCCESS &&
      (verdict_->verdict == FormulaResult::TRUE ||
      (Clock::now() - received_ < max_age && has_states()));
    return holds ? BT::NodeStatus::SUCCESS : BT::NodeStatus::FAILURE;
  }

private:
  /// The stamp is the valid time of the latest state, and zero before the first.
  bool has_states() const
  {
    const auto age = node_->now() - rclcpp::Time(verdict_->header.stamp);
    return age.seconds() < getInput<double>("max_state_age").value();
  }

  rclcpp::Node::SharedPtr node_;
  rclcpp::CallbackGroup::SharedPtr group_;
  rclcpp::executors::SingleThreadedExecutor executor_;
  rclcpp::Subscription<FormulaVerdict>::SharedPtr subscription_;
  FormulaVerdict::ConstSharedPtr verdict_;
  Clock::time_point received_;
};

/// SUCCESS: the formula is true; FAILURE: it is false, or there is no verdict.
class WaitForVerdict : public nav2_behavior_tree::BtActionNode<MonitorFormula>
{
public:
  using BtActionNode::BtActionNode;

  static BT::PortsList providedPorts()
  {
    return providedBasicPorts(
      {BT::InputPort<std::string>("formula"),
        BT::InputPort<int>("timeout", 60, "seconds"),
        BT::OutputPort<std::string>("explanation", "of the verdict, or the error")});
  }

  void on_tick() override
  {
    goal_.formula = getInput<std::string>("formula").value();
    goal_.name = name();
    goal_.timeout.sec = getInput<int>("timeout").value();
  }

  BT::NodeStatus on_success() override
  {
    setOutput("explanation", result_.result->explanation);
    return result_.result->verdict == FormulaResult::TRUE ?
           BT::NodeStatus::SUCCESS : BT::NodeStatus::FAILURE;
  }

  BT::NodeStatus on_aborted() override
  {
    setOutput("explanation", result_.result->exit_status.message);
    return BT::NodeStatus::FAILURE;
  }

  // Also after an operator has cancelled the evaluation.
  BT::NodeStatus on_cancelled() override
  {
    return BT::NodeStatus::FAILURE;
  }
};
}  // namespace formula_bt_nodes

BT_REGISTER_NODES(factory)
{
  factory.registerNodeType<formula_bt_nodes::FormulaHolds>("FormulaHolds");
  factory.registerBuilder<formula_bt_nodes::WaitForVerdict>(
    "WaitForVerdict", [](const std::string & name, const BT::NodeConfig & config) {
      return std::make_unique<formula_bt_nodes::WaitForVerdict>(
        name, "stream_reasoning_coordinator/monitor_formula", config);
    });
}
