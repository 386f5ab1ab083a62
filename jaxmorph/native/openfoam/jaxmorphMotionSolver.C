#include "jaxmorphMotionSolver.H"
#include "fixedValueFvPatchFields.H"
#include "processorPolyPatch.H"
#include "syncTools.H"
#include "valuePointPatchField.H"
#include "volFields.H"

#include "jmplan.h"

#include <algorithm>
#include <ctime>

namespace Foam
{
    defineTypeNameAndDebug(jaxmorphMotionSolver, 0);
    JM_SELECTABLE(jaxmorphMotionSolver);

    static const char* const HOW =
        "\n    Write the plan of this mesh, after decomposePar if the case is decomposed:"
        "\n        jaxmorph export CASE [--moving PATCH ...] [--fixed PATCH ...]\n";

    //- Keeps the value of higher precedence, of equal ones the smaller: processes agree to the last bit
    struct preferEqOp
    {
        void operator()(FixedList<scalar, 4>& x, const FixedList<scalar, 4>& y) const
        {
            if (y[0] > x[0] || (y[0] == x[0] && std::lexicographical_compare(y.begin(), y.end(), x.begin(), x.end())))
            {
                x = y;
            }
        }
    };

    //- The values that a patch gives to its points, or none
    static const valuePointPatchField<vector>* valuesOf(const pointPatchField<vector>& field)
    {
        return dynamic_cast<const valuePointPatchField<vector>*>(&field);
    }

    struct addToOp
    {
        void operator()(label& x, const label& y) const { x += y; }
    };

    struct eitherOp
    {
        void operator()(bool& x, const bool& y) const { x = x || y; }
    };

    //- The entries of jaxmorphCoeffs, or of the dictionary itself
    static const dictionary& coeffsOf(const dictionary& dict)
    {
        return dict.isDict("jaxmorphCoeffs") ? dict.subDict("jaxmorphCoeffs") : dict;
    }

    static fileName planOf(const dictionary& dict)
    {
        fileName plan("constant/jaxmorph.plan");
        coeffsOf(dict).readIfPresent("plan", plan);
        return plan;
    }

    //- The number of patches that all processes have
    static label nGlobalPatches(const polyMesh& mesh)
    {
        label n = 0;
        forAll(boundaryOf(mesh), patchi)
        {
            n += !isA<processorPolyPatch>(boundaryOf(mesh)[patchi]);
        }
        return n;
    }
}


// * * * * * * * * * * * * * * * * The plan and the mesh * * * * * * * * * * * * * * * * //

Foam::jaxmorphMotionSolver::jaxmorphMotionSolver(JM_PARAMETERS)
:
    displacementBase(JM_ARGUMENTS, typeName),
    file_(mesh.time().path()/planOf(dict)),
    plan_(jm_open(file_.c_str()), jm_close),
    points_(mesh.points())
{
    if (const char* error = jm_error(plan_.get()))
    {
        FatalErrorInFunction << file_ << ": " << error << HOW << exit(FatalError);
    }
    readRows();
    checkPoints();
    findMoving();
    affine_.reset(new affineFields(plan_.get(), wallAtRest()));
    readFrame(coeffsOf(dict));
    registerCellDisplacement();
    checkWall(wall());
    Info<< "jaxmorph: " << file_.name() << " moves the mesh by " << label(jm_moving(plan_.get())) << " points" << endl;
}


Foam::jaxmorphMotionSolver::~jaxmorphMotionSolver()
{}


void Foam::jaxmorphMotionSolver::readRows()
{
    const int32_t* layer = nullptr;
    int axes[2] = {0, 1};
    const label nodes = jm_layer(plan_.get(), &layer, axes);
    const bool flat = jm_dimension(plan_.get()) == 2;
    const label expected = flat ? nodes : label(jm_count(plan_.get()));
    if (flat && !nodes)
    {
        FatalErrorInFunction << file_ << " is of a mesh in two dimensions, not of a case's layer of cells." << HOW
            << exit(FatalError);
    }
    if (expected != points0().size())
    {
        FatalErrorInFunction << file_ << " is of " << expected << " points"
            << ", the mesh has " << points0().size() << '.' << HOW << exit(FatalError);
    }
    forAll(axes_, k)
    {
        axes_[k] = flat && k < 2 ? axes[k] : k;
    }
    row_.setSize(points0().size());
    forAll(row_, i)
    {
        row_[i] = flat ? layer[i] : i;
    }
}


void Foam::jaxmorphMotionSolver::checkPoints() const
{
    const label d = jm_dimension(plan_.get());
    scalar worst = 0, size = 0;
    label at = 0;
    forAll(points0(), i)
    {
        for (label k = 0; k < d; k++)
        {
            const scalar x = points0()[i][axes_[k]];
            const scalar apart = mag(x - jm_rest(plan_.get())[d*row_[i] + k]);
            size = max(size, mag(x));
            at = apart > worst ? i : at;
            worst = max(worst, apart);
        }
    }
    if (worst > 1e-7*size)   // parts have the ten digits that decomposePar writes as text
    {
        FatalErrorInFunction << file_ << " is of another mesh: points are up to " << worst
            << " apart, which is at " << points0()[at] << '.' << HOW << exit(FatalError);
    }
}


void Foam::jaxmorphMotionSolver::findMoving()
{
    labelList number(jm_count(plan_.get()), -1);
    for (label k = 0; k < label(jm_moving(plan_.get())); k++)
    {
        const label row = jm_nodes(plan_.get())[k];
        if (row >= 0)
        {
            number[row] = k;
        }
    }
    moving_.setSize(row_.size());
    forAll(moving_, i)
    {
        moving_[i] = number[row_[i]];
    }
    patchMoving_.setSize(nGlobalPatches(mesh()), 0);
    patchPoints_.setSize(patchMoving_.size(), 0);
    forAll(patchMoving_, patchi)
    {
        for (const label i : boundaryOf(mesh())[patchi].meshPoints())
        {
            patchMoving_[patchi] += moving_[i] >= 0;
            patchPoints_[patchi]++;
        }
    }
    combine(patchMoving_, addToOp());
    combine(patchPoints_, addToOp());
}


Foam::vectorField Foam::jaxmorphMotionSolver::wallAtRest() const
{
    const label d = jm_dimension(plan_.get());
    List<wallValue> found(jm_moving(plan_.get()), wallValue(scalar(0)));
    forAll(found, i)
    {
        const label node = jm_nodes(plan_.get())[i];
        for (label k = 0; node >= 0 && k < d; k++)
        {
            found[i][0] = 1;
            found[i][1 + k] = jm_rest(plan_.get())[d*node + k];
        }
    }
    combine(found, preferEqOp());
    vectorField wall(found.size());
    forAll(wall, i)
    {
        wall[i] = vector(found[i][1], found[i][2], found[i][3]);
    }
    return wall;
}


void Foam::jaxmorphMotionSolver::readFrame(const dictionary& coeffs)
{
    if (!coeffs.isDict("frame"))
    {
        return;
    }
    const dictionary& dict = coeffs.subDict("frame");
    frame_ = solidBodyMotionFunction::New(dict, mesh().time());
    word name;
    framed_.setSize(row_.size(), !dict.readIfPresent("cellZone", name));
    bool found = name.empty();
    forAll(mesh().cellZones(), zonei)
    {
        const labelList& cells = mesh().cellZones()[zonei];
        const bool isMeant = mesh().cellZones()[zonei].name() == name;
        found = found || isMeant;
        for (label i = 0; isMeant && i < cells.size(); i++)
        {
            for (const label facei : mesh().cells()[cells[i]])
            {
                for (const label pointi : mesh().faces()[facei])
                {
                    framed_[pointi] = true;
                }
            }
        }
    }
    if (!found)
    {
        FatalErrorInFunction << "the frame's cellZone " << name << " is not a zone of the mesh." << exit(FatalError);
    }
    syncTools::syncPointList(mesh(), framed_, eitherOp(), false);
}


void Foam::jaxmorphMotionSolver::registerCellDisplacement()
{
    const fvMesh* fv = dynamic_cast<const fvMesh*>(&mesh());
    if (!fv)
    {
        return;
    }
    wordList types(boundaryOf(mesh()).size(), calculatedFvPatchVectorField::typeName);
    forAll(patchMoving_, patchi)
    {
        if (patchMoving_[patchi] && valuesOf(pointDisplacement_.boundaryField()[patchi]))
        {
            types[patchi] = fixedValueFvPatchVectorField::typeName;
        }
    }
    IOobject object
    (
        "cellDisplacement", pointDisplacement_.instance(), mesh(), IOobject::READ_IF_PRESENT, IOobject::NO_WRITE
    );
    cellDisplacement_.reset
    (
        new volVectorField(object, *fv, dimensionedVector(pointDisplacement_.dimensions(), Zero), types)
    );
}


// * * * * * * * * * * * * * * * * * * The walls * * * * * * * * * * * * * * * * * * * * //

Foam::List<Foam::jaxmorphMotionSolver::wallValue> Foam::jaxmorphMotionSolver::wall() const
{
    List<wallValue> given(jm_moving(plan_.get()), wallValue(scalar(0)));
    const quaternion turn = frame_.valid() ? frame_->transformation().r() : quaternion::I;
    forAll(patchMoving_, patchi)
    {
        const valuePointPatchField<vector>* field = valuesOf(pointDisplacement_.boundaryField()[patchi]);
        if (!field)
        {
            continue;
        }
        // a node of two patches follows the one that moves as a whole; of two such, as elsewhere in OpenFOAM, the later
        const bool whole = patchMoving_[patchi] == patchPoints_[patchi];
        const scalar precedence = 1 + patchi + (whole ? patchMoving_.size() : 0);
        const labelList& nodes = field->patch().meshPoints();
        forAll(nodes, i)
        {
            if (moving_[nodes[i]] >= 0)
            {
                const bool isFramed = frame_.valid() && framed_[nodes[i]];
                const vector value = isFramed ? turn.invTransform((*field)[i]) : (*field)[i];
                wallValue u(precedence);
                forAll(axes_, k)
                {
                    u[1 + k] = value[k];
                }
                preferEqOp()(given[moving_[nodes[i]]], u);
            }
        }
    }
    combine(given, preferEqOp());
    return given;
}


void Foam::jaxmorphMotionSolver::checkWall(const List<wallValue>& given) const
{
    label missing = 0;
    for (const wallValue& u : given)
    {
        missing += u[0] == 0;
    }
    if (!missing)
    {
        return;
    }
    OStringStream patches;
    forAll(patchMoving_, patchi)
    {
        if (patchMoving_[patchi] && !valuesOf(pointDisplacement_.boundaryField()[patchi]))
        {
            const polyPatch& patch = boundaryOf(mesh())[patchi];
            patches << "\n        " << patch.name() << ", of type "
                << pointDisplacement_.boundaryField()[patchi].type();
        }
    }
    FatalErrorInFunction << missing << " of the " << given.size() << " points that the plan moves have no displacement."
        << " Of the patches that hold some of them these have no values in pointDisplacement:" << patches.str().c_str()
        << "\n    Give the walls a type with values, or write the plan without them. Types with values are"
        << "\n        fixedValue, for walls that preCICE or rigidBodyMotionSolver moves;"
        << "\n        sixDoFRigidBodyDisplacement and uncoupledSixDoFRigidBodyDisplacement, for a body with six degrees of"
        << "\n        freedom: in place of the motionSolver sixDoFRigidBodyMotion, whose walls are calculated;"
        << "\n        angularOscillatingDisplacement, uniformFixedValue and others, for a given motion." << HOW
        << exit(FatalError);
}


void Foam::jaxmorphMotionSolver::checkBoundary() const
{
    const label d = jm_dimension(plan_.get());
    const scalar size = max(mag(points0()));
    forAll(patchMoving_, patchi)
    {
        const valuePointPatchField<vector>* field = valuesOf(pointDisplacement_.boundaryField()[patchi]);
        scalar worst = 0;
        for (label i = 0; field && i < field->size(); i++)
        {
            const label node = field->patch().meshPoints()[i];
            const vector apart = (*field)[i] - pointDisplacement_.primitiveField()[node];
            for (label k = 0; moving_[node] < 0 && k < d; k++)
            {
                worst = max(worst, mag(apart[axes_[k]]));
            }
        }
        if (worst > 1e-9*size)
        {
            FatalErrorInFunction << "pointDisplacement and the plan differ by up to " << worst
                << " on patch " << boundaryOf(mesh())[patchi].name() << ", which the plan does not move."
                << "\n    Give the patch a fixedValue of zero if the plan holds it fixed, a type without values,"
                << " such as slip, if its points may slide, or write a plan that moves it." << HOW << exit(FatalError);
        }
    }
}


// * * * * * * * * * * * * * * * * * * The motion * * * * * * * * * * * * * * * * * * * //

Foam::tmp<Foam::pointField> Foam::jaxmorphMotionSolver::curPoints() const
{
    return tmp<pointField>(new pointField(points_));
}


void Foam::jaxmorphMotionSolver::solve()
{
    const label d = jm_dimension(plan_.get());
    if (points0().size() != row_.size())
    {
        FatalErrorInFunction << file_ << " is of " << row_.size() << " points, and the mesh has changed to "
            << points0().size() << ": a plan holds for one topology." << exit(FatalError);
    }
    pointDisplacement_.correctBoundaryConditions();
    const List<wallValue> given = wall();
    checkWall(given);

    const std::clock_t start = std::clock();
    std::vector<double> u(d*given.size());
    forAll(given, i)
    {
        for (label k = 0; k < d; k++)
        {
            u[d*i + k] = given[i][1 + axes_[k]];
        }
    }
    if (moved_.empty() || u != u_)
    {
        moved_.resize(d*jm_count(plan_.get()));
        if (!affine_->move(u, moved_) && jm_deform(plan_.get(), u.data(), moved_.data()))
        {
            FatalErrorInFunction << "not enough memory" << exit(FatalError);
        }
        u_.swap(u);
    }
    placePoints();
    checkBoundary();
    Info<< "jaxmorph: mesh moved in " << scalar(std::clock() - start)/CLOCKS_PER_SEC << " s" << endl;
}


void Foam::jaxmorphMotionSolver::placePoints()
{
    const label d = jm_dimension(plan_.get());
    const double* rest = jm_rest(plan_.get());
    forAll(points_, i)
    {
        points_[i] = points0()[i];
        for (label k = 0; k < d; k++)
        {
            // where points0 has fewer digits than the plan, it moves as far as the plan's point
            const label j = d*row_[i] + k;
            scalar& x = points_[i][axes_[k]];
            x = x == rest[j] ? moved_[j] : x + (moved_[j] - rest[j]);
        }
    }
    pointDisplacement_.primitiveFieldRef() = points_ - points0();
    if (!frame_.valid())
    {
        return;
    }
    const septernion motion = frame_->transformation();
    vectorField& displacement = pointDisplacement_.primitiveFieldRef();
    forAll(points_, i)
    {
        if (framed_[i])
        {
            points_[i] = motion.r().transform(points_[i] - motion.t());
            displacement[i] = motion.r().transform(displacement[i]);
        }
    }
}
