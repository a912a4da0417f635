use super::{Finding, Part, State, WeightsReport, WeightsState};
use crate::{
    Error, Result,
    machine::Expense,
    photos::TRAINED_SIZE,
    reconstruct::{MvDust3rParams, MvDust3rReconstructor},
    render::see3d::{See3d, See3dParams, See3dWeights},
    segment::mobilesamv2::{MobileSam, MobileSamParams, MobileSamWeights},
    weights::are_missing,
};
use tid3r_weights_convert::{Found, Network, Places};

/// Photos of a scene by which it is told what a reconstruction takes.
const PHOTOS: usize = 12;
/// Views by which it is told what See3D takes.
const VIEWS: usize = 8;
/// Seconds that people do not wait beside the machine.
const LONG: f64 = 600.0;

/// Which of the method's steps could run here, and what they would take.
pub(super) fn findings(places: &Places, reports: &[WeightsReport]) -> Vec<Finding> {
    vec![
        reconstruct(places, reports),
        segment(places, reports),
        render(places),
    ]
}

/// An error if one of these weights was found to be broken.
fn check(found: &[&Found], reports: &[WeightsReport]) -> Result<()> {
    let is_broken = |name: &str| {
        let mut broken = reports
            .iter()
            .filter(|report| report.state == WeightsState::Broken);
        broken.any(|report| report.network == name)
    };
    match found.iter().find(|found| is_broken(found.network.name)) {
        None => Ok(()),
        Some(found) => Err(Error::file(
            &found.folder,
            "the weights are broken",
            "see above",
        )),
    }
}

fn finding(name: &'static str, state: State, text: impl Into<String>) -> Finding {
    Finding::new(Part::Verbs, name, state, text)
}

/// One that cannot run, or not as it should.
fn hindered(name: &'static str, state: State, text: impl Into<String>, error: &Error) -> Finding {
    let text = text.into();
    finding(name, state, format!("{text}: {error}"))
}

/// One that takes so much.
fn taking(name: &'static str, what: &str, expense: Expense) -> Finding {
    let state = if expense.seconds > LONG {
        State::Slow
    } else {
        State::Ok
    };
    finding(name, state, format!("{what}: {expense}"))
}

fn reconstruct(places: &Places, reports: &[WeightsReport]) -> Finding {
    const NAME: &str = "reconstruct";
    let networks = MvDust3rReconstructor::NETWORKS.map(Network::named);
    let mut found = networks
        .iter()
        .flatten()
        .map(|network| places.find(network, None));
    let first = found.find_map(Result::ok);
    let Some(weights) = first else {
        return finding(
            NAME,
            State::Missing,
            "photos need weights of MV-DUSt3R or MV-DUSt3R+",
        )
        .fix("see above; recordings with depth need none: `tid3r import`");
    };
    let title = weights.network.title;
    let side = TRAINED_SIZE as usize;
    match check(&[&weights], reports).and_then(|()| expense_of(weights)) {
        Ok(expense) => taking(
            NAME,
            &format!("{PHOTOS} photos by {title}, at {side} pixels"),
            expense,
        ),
        Err(error) => hindered(NAME, State::Broken, title, &error),
    }
}

fn expense_of(weights: Found) -> Result<Expense> {
    let reconstructor = MvDust3rReconstructor::new(weights, MvDust3rParams::default(), None)?;
    let side = TRAINED_SIZE as usize;
    let estimate = reconstructor.estimate(PHOTOS, (side, side))?;
    estimate.rows_within(None)?;
    Ok(Expense {
        seconds: estimate.seconds,
        bytes: estimate.bytes,
    })
}

fn segment(places: &Places, reports: &[WeightsReport]) -> Finding {
    const NAME: &str = "segment";
    let expense = |weights: &MobileSamWeights| {
        check(&weights.all(), reports)?;
        MobileSam::new(weights, MobileSamParams::default())?.expense()
    };
    let found = MobileSamWeights::find_if_there(places, None);
    match found {
        Ok(Ok(weights)) => match expense(&weights) {
            Ok(expense) => taking(NAME, "a photo by MobileSAMv2", expense),
            Err(error) => hindered(NAME, State::Broken, "MobileSAMv2", &error),
        },
        Ok(Err(_)) => finding(
            NAME,
            State::Ok,
            "by colour and depth, without a network; MobileSAMv2 finds objects better",
        )
        .fix("see above for its weights"),
        Err(error) => hindered(NAME, State::Broken, "MobileSAMv2", &error),
    }
}

fn render(places: &Places) -> Finding {
    const NAME: &str = "render";
    let params = See3dParams::default();
    let expense = See3dWeights::find(places, &params)
        .and_then(|weights| See3d::new(weights, &params).expense(VIEWS));
    match expense {
        Ok(expense) => {
            let what = format!("by the fill, or {VIEWS} views by See3D (--refine see3d)");
            let finding = taking(NAME, &what, expense);
            match finding.state {
                State::Slow => finding.fix("--quality fast takes a third, --size 384 another"),
                _ => finding,
            }
        }
        Err(error) if are_missing(&error) => finding(
            NAME,
            State::Ok,
            "by the fill, without a network; See3D (--refine see3d) would make photorealistic pictures",
        )
        .fix("see above for its weights"),
        // The fill is what renders unless See3D is asked for.
        Err(error) => hindered(NAME, State::Ok, "by the fill; See3D cannot be used", &error),
    }
}
