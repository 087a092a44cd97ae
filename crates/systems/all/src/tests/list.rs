//! The list of systems.

use crate::BUILT_IN;
use kinegrad_cc_motion::CcMotion;
use kinegrad_train::Systems;

#[test]
fn every_recipe_is_of_one_system() {
    for recipe in BUILT_IN.recipes() {
        assert!(BUILT_IN.of_recipe(recipe.name).is_some());
    }
    assert!(BUILT_IN.of_recipe("nobody's").is_none());
}

#[test]
#[should_panic(expected = "two recipes are called `decoder`: of the systems `cc_motion` and")]
fn a_list_in_which_one_recipe_hides_another_is_refused() {
    Systems(&[&CcMotion, &CcMotion]).of_recipe("decoder");
}
